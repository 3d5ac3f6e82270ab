"""The house rules that a reader relies on: who may import whom, what starts cold, how long a file may be."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "tacgen"

# Folders beside the line, whose modules stand in ORDER one by one.
GROUPS = ("spec", "solid", "solve", "labels", "image", "files", "look")
FOLDERS = {"tacgen", *(f"tacgen.{name}" for name in (*GROUPS, "fem", "optics"))}

# A module imports only from lines above its own. The line of the product is marked with *.
ORDER = [
    {"__init__", "errors", "spec.part", *(f"{name}.__init__" for name in GROUPS if name != "solve")},
    {"console", "spec.turns"},
    {"spec.yamlfile", "spec.assets", "spec.sensor", "files.partfile", "image.variants", "spec.posetable"},
    {"spec.explain"},
    {"spec.moves", "spec.indenters"},
    {"recipe"},  # *
    {"files.store"},
    {"solid.geometry"},
    {"spec.motions", "spec.lit", "image.photo"},
    {"spec.limits"},
    {"spec.load"},
    {"plan"},  # *
    {"solid.gel", "solid.tessellate"},
    {"path"},
    {"scene"},  # *
    {"solid.tetmesh"},
    {"mesh"},  # *
    {"solve.options", "solve.state", "solve.linear_solvers", "solve.force_control", "solve.lagging"},
    {"solve.condensation", "solve.newton"},
    {"solve.bulk", "solve.contact_newton"},
    {"solve.problem", "solve.predictor"},
    {"solve.bulk_newton", "solve.full_newton", "solve.mesh_contact"},
    {"solve.equilibrium"},
    {"solve.load_stepping"},
    {"solve.frames"},
    {"solve.warm"},
    {"solve.__init__"},  # *
    {"solve.foresee"},
    {"fields"},  # *
    {"labels.maps", "labels.stress", "image.tracer", "labels.faces", "labels.drift"},
    {"render"},  # *
    {"files.layout"},
    {"bundle"},  # *
    {"derived", "look.section", "files.source", "files.resume"},
    {"export"},
    {
        "pipeline",
        "check",
        "calibrate",
        "look.show",
        "doctor",
        "spec.schema",
        "look.listing",
        "look.table",
        "look.progress",
    },
    {"batch", "look.show_field"},
    {"files.survey", "files.pack", "torch"},
    {"look.overview"},
    {"look.card", "look.report"},
    {"bench"},
    {"cli"},
    {"__main__"},
]
LIBRARIES = {"fem", "optics"}  # know no stage; from `geometry` on, modules may use them
FIRST_USER_OF_LIBRARIES = next(i for i, line in enumerate(ORDER) if "solid.geometry" in line)
ALLOWED_IN_LIBRARIES = {"numpy", "scipy", "numba"}

# Heavy packages and where they may be imported, always inside functions.
HOMES = {
    "mitsuba": {"image.tracer"},
    "drjit": {"image.tracer"},
    "matplotlib": {"look.show", "look.show_field", "bench.kit", "bench.optics"},
    "mpl_toolkits": {"look.show"},
    "h5py": {"bundle", "doctor", "export.vtkhdf", "export.univtac", "files.pack", "torch"},
    "cvxopt": {"solve.linear_solvers"},
    "pymetis": {"solve.linear_solvers"},
    "ruamel": {"spec.yamlfile"},
    "trimesh": {"solid.geometry"},
    "igl": {"solid.geometry"},
    "pymeshlab": {"solid.geometry"},
    "pytetwild": {"solid.tetmesh"},
    "ipctk": {"fem.ipc"},
    "platformdirs": {"image.variants"},
    "rich": {"look.progress"},
    "PIL": {"image.photo", "look.report", "export.lerobot", "export.univtac", "export.webdataset"},
    "distributed": {"batch.cluster"},
    "pyarrow": {"export.lerobot"},
    "OpenEXR": {"export.exr"},
    "webdataset": {"export.webdataset"},
}
NOT_NUMPY = {
    "cli",
    "console",
    "errors",
    "spec.part",
    "recipe",
    "spec.sensor",
    "spec.assets",
    "plan",
    "spec.load",
    "spec.lit",
    "image.photo",
    "spec.limits",
    "spec.explain",
    "spec.yamlfile",
    "spec.turns",
    "spec.moves",
    "spec.indenters",
    "spec.posetable",
    "spec.motions",
}


def files() -> dict[str, Path]:
    """Every module by its name below the package: `recipe`, `fem.shapes`."""
    return {".".join(path.relative_to(PACKAGE).with_suffix("").parts): path for path in sorted(PACKAGE.rglob("*.py"))}


def imports(path: Path) -> list[tuple[str, bool]]:
    """(module, whether at module level) of every import but those for type checkers only."""
    found: list[tuple[str, bool]] = []

    def walk(node: ast.AST, top: bool) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if isinstance(child, ast.Import):
                found.extend((alias.name, top) for alias in child.names)
            elif isinstance(child, ast.ImportFrom):
                assert child.level == 0, f"{path}: relative import"
                found.extend((loaded(child.module or "", alias.name), top) for alias in child.names)
            walk(child, top and not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda))

    walk(ast.parse(path.read_text(encoding="utf-8")), True)
    return list(dict.fromkeys(found))


def loaded(module: str, name: str) -> str:
    """What `from module import name` loads: a module of that name in one of our folders, or the first alone."""
    if module not in FOLDERS:
        return module
    here = PACKAGE.joinpath(*module.split(".")[1:], name)
    return f"{module}.{name}" if here.is_dir() or here.with_suffix(".py").exists() else module


def rank(module: str) -> int:
    name = module if module.split(".")[0] in GROUPS else module.split(".")[0]
    assert any(name in line for line in ORDER), f"{name}: say in ORDER where this module stands"
    return next(i for i, line in enumerate(ORDER) if name in line)


def inside(module: str) -> str:
    """tacgen.fem.shapes -> fem.shapes; tacgen -> __init__; tacgen.solve -> solve.__init__."""
    name = module.removeprefix("tacgen").lstrip(".")
    return f"{name}.__init__".lstrip(".") if name in ("", *GROUPS) else name


@pytest.mark.parametrize("name", files())
def test_imports_point_up_the_line(name: str):
    for module, _ in imports(files()[name]):
        package = module.split(".")[0]
        if package != "tacgen":
            continue
        target = inside(module)
        library = target.split(".")[0] in LIBRARIES
        if name.split(".")[0] in LIBRARIES:
            assert target.split(".")[0] == name.split(".")[0], f"{name} imports {module}"
        elif library:
            assert rank(name) >= FIRST_USER_OF_LIBRARIES, f"{name} imports {module}"
        else:
            folder, own = target.split(".")[0], target.split(".")[0] == name.split(".")[0]
            own_folder = own and folder in ("batch", "bench", "calibrate", "export")
            assert rank(target) < rank(name) or own_folder, f"{name} imports {module}"
            if folder in GROUPS and not own:  # which runs the folder's own file first
                assert rank(f"{folder}.__init__") < rank(name), f"{name} imports {module}"


@pytest.mark.parametrize("name", [n for n in files() if n.split(".")[0] in LIBRARIES])
def test_libraries_need_numerics_only(name: str):
    for module, _ in imports(files()[name]):
        package = module.split(".")[0]
        known = package in sys.stdlib_module_names | ALLOWED_IN_LIBRARIES | {"tacgen"}
        assert known or name in HOMES.get(package, ()), f"{name} imports {module}"


@pytest.mark.parametrize("name", files())
def test_heavy_packages_are_imported_at_home_and_late(name: str):
    for module, top in imports(files()[name]):
        package = module.split(".")[0]
        if package in HOMES:
            assert name in HOMES[package], f"{name} imports {module}"
            assert not top, f"{name} imports {module} at module level"
        if package in ("numpy", "scipy", "numba") and name in NOT_NUMPY:
            assert not top, f"{name} imports {module} at module level"


@pytest.mark.parametrize("name", files())
def test_a_file_is_one_idea(name: str):
    assert len(files()[name].read_text(encoding="utf-8").splitlines()) <= 400


def loaded_by(code: str) -> set[str]:
    """Top-level packages that a fresh interpreter holds after running `code`."""
    ask = "import sys; print(' '.join(sorted({m.split('.')[0] for m in sys.modules})), file=sys.__stderr__)"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\n{ask}"], capture_output=True, text=True, cwd=ROOT, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return set(done.stderr.splitlines()[-1].split())


def command(*args: str) -> str:
    return f"from tacgen.cli import app\ntry:\n    app({list(args)!r})\nexcept SystemExit as e:\n    assert not e.code"


HEAVY = {
    "numpy",
    "scipy",
    "numba",
    "mitsuba",
    "drjit",
    "h5py",
    "matplotlib",
    "cvxopt",
    "pymetis",
    "trimesh",
    "igl",
    "ipctk",
}


def test_help_starts_cold():
    assert loaded_by(command("--help")).isdisjoint({*HEAVY, "pydantic", "ruamel"})


@pytest.mark.parametrize("args", [("validate", "quickstart"), ("list",), ("schema",)])
def test_looking_at_recipes_starts_no_numerics(args: tuple[str, ...]):
    # one scene needs a seed, which NumPy draws; nothing heavier
    assert loaded_by(command(*args)).isdisjoint(HEAVY - {"numpy"})


def test_a_scene_without_contact_between_meshes_leaves_its_toolkit_alone():
    assert "ipctk" not in loaded_by("import tacgen.pipeline, tacgen.fem.ipc")


def test_the_check_sees_a_bad_import(tmp_path: Path):
    bad = tmp_path / "bad.py"
    bad.write_text("import mitsuba\ndef f():\n    from tacgen import cli\n    import h5py\n")
    assert imports(bad) == [("mitsuba", True), ("tacgen.cli", False), ("h5py", False)]
    bad.write_text("from tacgen.solve import State, states, foresee\nfrom tacgen import __version__\n")
    assert imports(bad) == [("tacgen.solve", True), ("tacgen.solve.foresee", True), ("tacgen", True)]
    assert [inside(module) for module, _ in imports(bad)] == ["solve.__init__", "solve.foresee", "__init__"]


def test_every_line_of_the_order_is_a_module():
    known = {name if name.split(".")[0] in GROUPS else name.split(".")[0] for name in files()}
    assert set().union(*ORDER) == known - LIBRARIES
    assert sum(map(len, ORDER)) == len(set().union(*ORDER))
    assert set().union(*HOMES.values()) | NOT_NUMPY <= {name.removesuffix(".__init__") for name in files()}
