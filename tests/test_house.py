"""The house rules that a reader relies on: who may import whom, what starts cold, how long a file may be."""

import ast
import sys
from collections import Counter
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

from helpers.program import ran

from tacgen.outputs import OUTPUTS

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "tacgen"

# A package or a module of the top level imports only from those above it.
LAYERS = [
    *("base", "physics", "fem", "geometry", "sensor", "optics", "mechanics", "tensor_engine", "tensor_optics"),
    *("render", "outputs", "recipe", "bundle", "export", "report", "torch", "batch", "api", "calibrate", "replay"),
    *("touch", "cli", "__main__"),
]
# Numerics that know no recipe and no scene, in type hints either, and what they may import. Optics names the classes
# of a sensor file in hints alone: it runs on anything that holds the same numbers.
LIBRARIES = {"physics": {"base"}, "fem": {"base", "physics"}, "optics": {"base", "physics", "geometry"}}
IN_HINTS = {"optics": {"sensor"}}
ALLOWED_IN_LIBRARIES = {"numpy", "scipy"}
TENSORS_OF_BOTH = "physics.runtime"  # launches kernels on arrays of NumPy and of PyTorch

# Heavy packages and where they may be imported, always inside functions.
HOMES = {
    "mitsuba": {"render.mitsuba_path"},
    "drjit": {"render.mitsuba_path"},
    "matplotlib": {
        *("report.animation", "report.bundle_figure", "report.field_figure", "report.fit_figures"),
        *("report.force_figure", "report.sheet", "report.viewer"),
    },
    "mpl_toolkits": {"report.bundle_figure"},
    "h5py": {"bundle.hdf5_file", "bundle.pack", "cli.doctor", "replay.array_log"},
    "cvxopt": {"mechanics.blas_kernels"},
    "pymetis": {"mechanics.linear_solvers"},
    "ruamel": {"sensor.yaml_source"},
    "trimesh": {"geometry.convex_edges", "geometry.mesh_file", "geometry.mesh_import", "touch.surfaces"},
    "igl": {"geometry.exact_edges", "geometry.mesh_file", "geometry.mesh_import"},
    "pymeshlab": {"geometry.mesh_file"},
    "pytetwild": {"mechanics.ftetwild"},
    "platformdirs": {"base.array_cache"},
    "threadpoolctl": {"batch.pipeline", "render.pictures", "mechanics.blas_kernels"},
    "rich": {"report.progress"},
    "PIL": {"render.photograph", "bundle.image_file", "render.jpeg"},
    "distributed": {"batch.dask_engine"},
    "pyarrow": {"export.lerobot", "touch.into_lerobot", "touch.lerobot_data"},
    "OpenEXR": {"export.exr"},
    "webdataset": {"export.webdataset"},
    "zarr": {"export.zarr", "touch.umi"},
    "numcodecs": {"export.zarr"},
    "rerun": {"export.rerun", "touch.into_rerun"},
    "mujoco": {"touch.kinematics"},
}
# Who writes, replaces or deletes files, by what; all others go through `output_file`, `whole_folder` or `atomic_file`.
WRITERS = {
    "base.atomic_file": {"os.open", "os.replace", "os.unlink"},
    "base.output_file": {"open", "os.replace", "rmdir", "unlink"},
    "bundle.whole_folder": {"rename", "rmtree"},
    "bundle.hdf5_file": {"h5py.File"},  # through a sink of atomic_file
    # beside bundles, after `journal.claimed` has refused what no run wrote
    "bundle.journal": {"os.open", "unlink"},
    "batch.__init__": {"unlink"},
    "batch.cuda_engine": {"os.rmdir", "unlink"},
    # to a path of `output_file.written`
    "api.frames": {"copyfile"},
    "touch.into_robomimic": {"copyfile"},
    "report.animation": {"saving"},
    "report.bundle_figure": {"savefig"},
    # into a new folder of `whole_folder`, by packages that take a path
    "export.lerobot": {"ParquetWriter", "write_table"},
    "export.webdataset": {"ShardWriter"},
    "export.zarr": {"open_group"},
    "touch.into_lerobot": {"ParquetWriter", "write_table", "copyfile", "os.link"},
    # into memory
    **{name: {"np.save", "np.savez"} for name in ("base.array_cache", "batch.solution_file", "export.__init__")},
    "mechanics.ftetwild": {"np.savez"},
    # no files of a user's
    "physics.runtime": {"write_bytes"},  # in a temporary folder, from which Warp loads code
    "base.regular_file": {"os.open"},  # to read
    "base.terminal": {"os.open"},  # /dev/null
    "batch.worker_main": {"open"},  # of /proc
}
WRITES = {
    *("write_text", "write_bytes", "savefig", "saving", "touch", "symlink_to", "hardlink_to", "rename", "unlink"),
    *("rmdir", "tofile", "rmtree", "copyfile", "copytree", "copy2", "mkstemp", "NamedTemporaryFile"),
    *("write_table", "ParquetWriter", "ShardWriter", "open_group", "imwrite", "imsave", "to_csv", "to_parquet"),
    *(f"os.{name}" for name in ("open", "replace", "rename", "link", "symlink", "unlink", "remove", "rmdir")),
    *(f"np.{name}" for name in ("save", "savez", "savez_compressed", "savetxt")),
    *("h5py.File", "shutil.copy", "shutil.move"),
}
# Who writes at a path whatever is there, through `atomic_file`: each has asked before whether it may.
REPLACE = {
    *("base.output_file", "base.array_cache", "bundle.bundle", "bundle.journal", "bundle.pack", "bundle.whole_folder"),
    *("batch.solution_file", "cli.doctor", "export.vtkhdf", "export.univtac", "batch.pipeline", "report.dataset_card"),
}
# Who reads other than through `regular_file`, which refuses pipes and devices, and notes what is an input.
READERS = {
    "base.output_file": {"open"},  # what it has just written
    # from memory, or an open file
    **{name: {"np.load"} for name in ("base.array_cache", "mechanics.ftetwild", "replay.array_log")},
    **{name: {"Image.open"} for name in ("render.photograph", "render.jpeg")},
    "batch.solution_file": {"np.load"},  # of this run
    "touch.umi": {"open"},  # by Zarr, which takes a path
    # what tacgen has just exported
    **{name: {"read_text"} for name in ("export.lerobot", "report.hub_card")},
    # of the installed package, or of the system
    **{name: {"read_text"} for name in ("report.catalogue", "report.html_page", "batch.worker_process")},
    **{name: {"read_text", "np.load"} for name in ("mechanics.blas_kernels", "mechanics.ftetwild")},
    "physics.runtime": {"read_bytes"},
    "base.machine": {"read_text"},
    "base.regular_file": {"read_bytes"},  # its own
}
READS = {"read_text", "read_bytes", "np.load", "np.fromfile", "np.loadtxt", "np.genfromtxt", "Image.open", "imread"}
PROTOCOL = {"OUTPUT"}  # constants that every module of a folder has, as docs/EXTENDING.md says
LINES_BESIDE = 5841  # of benchmarks/ and scripts/ together, without the referee
LINES_OF_REFEREE, LINES_OF_PLAYER = 1000, 80  # of the referee without its players, and of each player
NOT_NUMPY = {
    *(f"cli.{name}" for name in ("main", "calibrate", "common", "look", "replay", "sensor", "touch")),
    *(f"sensor.{name}" for name in ("base_model", "imperfections", "layers", "model", "optics_checks")),
    *("sensor.validation_messages", "sensor.yaml_source", "recipe.model", "recipe.assets", "recipe.plan"),
    *("recipe.row", "recipe.sampling", "recipe.sensor_base", "recipe.sensor_checks", "recipe.usual_sizes"),
    *("recipe.loading", "recipe.checks", "recipe.grasp_checks", "recipe.trajectory", "recipe.indenters"),
    *("recipe.pose_table", "recipe.trajectory_checks", "outputs", "outputs.base"),
    *(f"outputs.{name}" for name in OUTPUTS),
}


@cache
def files() -> dict[str, Path]:
    """Every module by its name below the package: `torch`, `fem.elements`."""
    return {".".join(path.relative_to(PACKAGE).with_suffix("").parts): path for path in sorted(PACKAGE.rglob("*.py"))}


@cache
def text_of(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(text_of(path))


@cache
def imports(path: Path, hints: bool = False) -> list[tuple[str, bool]]:
    """(module, whether at module level) of every import; those for type checkers only if `hints` are asked for."""
    found: list[tuple[str, bool]] = []

    def walk(node: ast.AST, top: bool) -> None:
        for child in ast.iter_child_nodes(node):
            if not hints and isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if isinstance(child, ast.Import):
                found.extend((alias.name, top) for alias in child.names)
            elif isinstance(child, ast.ImportFrom):
                assert child.level == 0, f"{path}: relative import"
                found.extend((loaded(child.module or "", alias.name), top) for alias in child.names)
            walk(child, top and not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda))

    walk(tree(path), True)
    return list(dict.fromkeys(found))


def loaded(module: str, name: str) -> str:
    """What `from module import name` loads: a module of that name in one of our packages, or the first alone."""
    if module.split(".")[0] != "tacgen":
        return module
    here = PACKAGE.joinpath(*module.split(".")[1:], name)
    return f"{module}.{name}" if here.is_dir() or here.with_suffix(".py").exists() else module


def layer(module: str) -> str:
    """tacgen.fem.elements -> fem; tacgen -> "" (the version)."""
    return module.removeprefix("tacgen").lstrip(".").split(".")[0]


def test_imports_point_up_the_layers() -> None:
    wrong = []
    for name, path in files().items():
        if (own := name.split(".")[0]) == "__init__":  # the public names, from everywhere
            continue
        for module, _ in imports(path, hints=True):
            if module.split(".")[0] != "tacgen" or (target := layer(module)) in ("", own):
                continue
            foreign = own in LIBRARIES and target not in LIBRARIES[own] | IN_HINTS.get(own, set())
            if foreign or LAYERS.index(target) >= LAYERS.index(own):
                wrong.append(f"{name} imports {module}")
    assert wrong == []


def test_no_circle_of_modules() -> None:
    """Type hints and imports inside functions count; what a package's face hands on is imported from its module."""
    names = {f"tacgen.{name}".removesuffix(".__init__"): path for name, path in files().items()}
    graph = {name: {module for module, _ in imports(path, hints=True) if module in names} - {name}
             for name, path in names.items()}  # fmt: skip
    TopologicalSorter(graph).prepare()  # CycleError names the modules


def test_libraries_need_numerics_only() -> None:
    wrong = []
    for name, path in files().items():
        if (own := name.split(".")[0]) not in LIBRARIES:
            continue
        for module, _ in imports(path):
            package, target = module.split(".")[0], layer(module)
            allowed = sys.stdlib_module_names | ALLOWED_IN_LIBRARIES | {"tacgen", "warp" if own == "physics" else ""}
            if name == TENSORS_OF_BOTH:
                allowed = allowed | {"torch"}
            foreign = package == "tacgen" and target not in {"", own, *LIBRARIES[own]}
            if foreign or (package not in allowed and name not in HOMES.get(package, ())):
                wrong.append(f"{name} imports {module}")
    assert wrong == []


def test_heavy_packages_are_imported_in_their_modules_and_inside_functions() -> None:
    wrong = []
    for name, path in files().items():
        for module, top in imports(path):
            package = module.split(".")[0]
            if package in HOMES and name not in HOMES[package]:
                wrong.append(f"{name} imports {module}")
            if top and (package in HOMES or (package in ("numpy", "scipy") and name in NOT_NUMPY)):
                wrong.append(f"{name} imports {module} at module level")
    assert wrong == []


def test_only_tensor_packages_need_pytorch_and_others_import_them_inside_functions() -> None:
    wrong, tensors = [], ("tensor_engine", "tensor_optics")
    for name, path in files().items():
        inside = name.split(".")[0] in tensors
        for module, top in imports(path):
            if name == TENSORS_OF_BOTH and not top:
                continue
            if module.split(".")[0] == "torch" and (not inside or name.endswith("__init__")):
                wrong.append(f"{name} imports {module}")
            if layer(module) in tensors and module.startswith("tacgen") and top and not inside:
                wrong.append(f"{name} imports {module} at module level")
    assert wrong == []


def beside() -> list[Path]:
    """The programs beside the package: benches and scripts."""
    return [path for folder in ("benchmarks", "scripts") for path in sorted((ROOT / folder).glob("*.py"))]


def referee() -> tuple[list[Path], list[Path]]:
    """The files of the referee, and of its players."""
    folder = ROOT / "benchmarks" / "referee"
    return sorted(folder.glob("*.py")), sorted((folder / "players").glob("*.py"))


def test_a_file_is_one_idea_and_programs_beside_the_package_keep_to_their_lines() -> None:
    """A bench earns its place by figures of README.md or docs/RESULTS.md, a script by a file that ships; a program that
    has answered its question goes."""
    own, players = referee()
    lines = {path: len(text_of(path).splitlines()) for path in (*files().values(), *beside(), *own, *players)}
    assert [path.name for path, count in lines.items() if count > 400 and path not in players] == []
    assert sum(lines[path] for path in beside()) <= LINES_BESIDE
    assert sum(lines[path] for path in own) <= LINES_OF_REFEREE
    assert {path.name: lines[path] for path in players if lines[path] > LINES_OF_PLAYER} == {}


def loaded_by(*commands: str) -> set[str]:
    """Top-level packages that a fresh interpreter holds after running these commands."""
    run = f"from tacgen.cli.main import app\nfor words in {[command.split() for command in commands]}:\n"
    run += "    try:\n        app(words)\n    except SystemExit as end:\n        assert not end.code"
    ask = "import sys\nprint('\\n' + ' '.join({m.split('.')[0] for m in sys.modules}), file=sys.__stdout__)"
    return set(ran("-c", f"{run}\n{ask}").splitlines()[-1].split())


HEAVY = {"numpy", "scipy", "mitsuba", "drjit", "h5py", "matplotlib", "cvxopt", "pymetis", "trimesh", "igl"}


def test_help_and_reading_recipes_import_no_numerics():
    assert loaded_by("--help").isdisjoint({*HEAVY, "pydantic", "ruamel"})
    # one scene needs a seed, which NumPy draws; nothing heavier
    assert loaded_by("validate quickstart", "list", "schema").isdisjoint(HEAVY - {"numpy"})


def test_the_check_sees_a_bad_import(tmp_path: Path):
    bad = tmp_path / "bad.py"
    bad.write_text("import mitsuba\ndef f():\n    from tacgen import bundle\n    import h5py\n")
    assert imports(bad) == [("mitsuba", True), ("tacgen.bundle", False), ("h5py", False)]
    other = tmp_path / "other.py"
    other.write_text("from tacgen.mechanics import State, states, presolve\nfrom tacgen import __version__\n")
    assert imports(other) == [("tacgen.mechanics", True), ("tacgen.mechanics.presolve", True), ("tacgen", True)]
    assert [layer(module) for module, _ in imports(other)] == ["mechanics", "mechanics", ""]


def test_every_layer_is_there() -> None:
    assert sorted(LAYERS) == sorted({name.split(".")[0] for name in files()} - {"__init__"})
    assert set().union(*HOMES.values()) | NOT_NUMPY <= {name.removesuffix(".__init__") for name in files()}


def test_no_two_public_classes_share_a_name() -> None:
    names = [node.name for path in files().values() for node in tree(path).body if isinstance(node, ast.ClassDef)]
    assert [name for name in names if names.count(name) > 1 and not name.startswith("_")] == []


def constants(path: Path) -> set[str]:
    """The UPPER_CASE names that a module assigns at its top level; type variables are none."""
    found = set[str]()
    for node in tree(path).body:
        targets = [node.target] if isinstance(node, ast.AnnAssign) else getattr(node, "targets", [])
        if not ast.unparse(getattr(node, "value", None) or node).startswith("TypeVar("):
            stored = (each for target in targets for each in ast.walk(target) if isinstance(each, ast.Name))
            found |= {each.id for each in stored if isinstance(each.ctx, ast.Store) and each.id.isupper()}
    return found


def test_a_constant_says_what_it_is() -> None:
    """MAX_BARRIER_STIFFENINGS, not STIFFENINGS: a name that stands in more than two modules says too little."""
    names = Counter(name for path in files().values() for name in constants(path) if name not in PROTOCOL)
    assert [name for name, modules in names.items() if modules > 2] == []


def test_the_check_sees_constants(tmp_path: Path) -> None:
    some = tmp_path / "some.py"
    some.write_text('T = TypeVar("T")\nA, _B = 1, 2\nC: int = 3\nlower = 4\nD["x"] = 5\ndef f():\n    E = 6\n')
    assert constants(some) == {"A", "_B", "C"}


@cache
def calls(path: Path) -> list[tuple[ast.Call, str]]:
    """The calls in a module, each with the name that is called: `open`, `os.open`, `path.write_text`."""
    nodes = (node for node in ast.walk(tree(path)) if isinstance(node, ast.Call))
    return [(node, ast.unparse(node.func)) for node in nodes if isinstance(node.func, ast.Attribute | ast.Name)]


def access(path: Path) -> tuple[set[str], set[str]]:
    """By what a module writes files, and by what it reads them, other than through our own modules."""
    writes, reads = set[str](), set[str]()
    for node, name in calls(path):
        last = name.rpartition(".")[2]
        if name in ("open", "io.open") or (last == "open" and not isinstance(node.func, ast.Name) and _of_a_path(name)):
            given = node.args[name in ("open", "io.open") :] + [k.value for k in node.keywords if k.arg == "mode"]
            mode = next((str(a.value) for a in given if isinstance(a, ast.Constant)), "r")
            (writes if set(mode) & set("wax+") else reads).add("open")
        found = name if name in WRITES | READS else last
        if found in WRITES:
            writes.add(found)
        if found in READS and not name.startswith("regular_file."):
            reads.add(found)
    return writes, reads


def _of_a_path(name: str) -> bool:
    return name.split(".")[0] not in ("os", "Image", "h5d", "h5o", "h5a", "typer", "regular_file")


def test_files_are_written_and_read_in_their_homes_alone() -> None:
    """So that one rule holds for all of them: nothing that is read, foreign or edited is replaced."""
    wrong = []
    for name, path in files().items():
        writes, reads = access(path)
        wrong += [f"{name} writes by {each}" for each in sorted(writes - WRITERS.get(name, set()))]
        wrong += [f"{name} reads by {each}" for each in sorted(reads - READERS.get(name, set()))]
        called = {each.removeprefix("atomic_file.") for _, each in calls(path)}
        if called & {"write", "published", "Sink"} and "atomic_file" in text_of(path) and name not in REPLACE:
            wrong.append(f"{name} replaces through atomic_file")
    assert wrong == []
    assert {*WRITERS, *READERS, *REPLACE} <= files().keys()


def test_the_check_sees_a_bad_writer_and_reader(tmp_path: Path) -> None:
    bad = tmp_path / "bad.py"
    calls = "open('a', 'w') path.open('rb') path.open(mode='x') np.save(a,b) Path(a).read_text() os.replace(a,b)"
    bad.write_text(calls.replace(") ", ")\n"))
    assert access(bad) == ({"open", "np.save", "os.replace"}, {"open", "read_text"})


def test_only_one_module_prints_results() -> None:
    """Which escapes control characters of names; messages go through `terminal.say`."""
    told = [name for name, path in files().items() for _, each in calls(path) if each in ("typer.echo", "click.echo")]
    assert told == ["cli.common"]


def test_a_docstring_stands_alone() -> None:
    """It says what the thing is: no reader has read the one above."""
    wrong = []
    own, players = referee()
    others = {f"{path.parent.name}.{path.stem}": path for path in (*beside(), *own, *players)}
    for name, path in {**files(), **others}.items():
        nodes = (n for n in ast.walk(tree(path)) if isinstance(n, ast.Module | ast.ClassDef | ast.FunctionDef))
        begun = [text for node in nodes if (text := ast.get_docstring(node) or "")]
        unclear = ("The same", "Those", "What ", "Of ")
        wrong += [f"{name}: {text.splitlines()[0]}" for text in begun if text.startswith(unclear)]
    assert wrong == []
