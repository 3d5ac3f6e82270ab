"""The counts of docs/EXTENDING.md: how many files of tacgen/ an output, a shape, a law and a sensor touch.

Each is really added to a copy of the package, by the edits that the page describes, and used there.
"""

import re
import shutil
from filecmp import cmp
from pathlib import Path
from typing import NamedTuple

import h5py
import pytest
from helpers.program import ran
from helpers.small_recipe import HEAD, PRESS

ROOT = Path(__file__).parents[1]
TOY_SHAPE = "indenter={shape: pearl, radius_mm: 4}"
TOY_LAW = "sensor_overrides={gel.layers: [{law: toy, name: a, thickness_mm: 4, shear_mpa: 0.1, bulk_mpa: 4}]}"


class Edit(NamedTuple):
    """`new` at the place of `old` in a file of the repository; "" stands for the file's end, or a new file."""

    file: str
    old: str
    new: str


class Toy(NamedTuple):
    """A new thing: its edits, the files of tacgen/ that they may touch, and a change of the recipe that uses it."""

    edits: tuple[Edit, ...]
    files: int
    use: str
    listed: tuple[str, str] | None = None  # a kind of `tacgen list`, and what must be in it


OUTPUT = '''"""The lowest node of the gel, for a test."""

from tacgen.outputs.base import Entry, Output

OUTPUT = Output(
    "z of the lowest node",
    {"/frames/lowest": Entry("<f8", "N", "mm", "z of the lowest node")},
    lambda frame: {"/frames/lowest": frame.state.x[:, 2].min()},
)
'''
SHAPE = '''

@dataclass(frozen=True)
class PearlSdf(SphereSdf):
    """A ball of another name, whose closest core point is another function."""

    core: ClassVar[str] = "pearl"
'''
CORE = """@wp.func
def pearl(shapes: wp.array2d(dtype=real), s: int, p: wp.vec3d) -> Core:
    core = Core()
    core.radius = shapes[s, A]
    core.closest = wp.vec3d(real(0.0), real(0.0), core.radius)
    core.out = wp.normalize(wp.vec3d(real(0.0), real(0.0), real(-2.0)))
    return core


@wp.func
def core_of("""
BRANCH = """    if kind == ShapeNumber.pearl:
        return pearl(shapes, s, p)
    return wedge(shapes, s, p)
"""
INDENTER = '''class Pearl(AnyIndenter):
    """A ball of another name."""

    thin: ClassVar[dict[str, float]] = {"radius_mm": 1}
    shape: Literal["pearl"] = "pearl"
    radius_mm: Positive


Indenter = Annotated['''
LAW = '''

@dataclass(frozen=True)
class Toy(NeoHooke):
    """Gent (1996) with a stretch limit of 20, by shear and bulk modulus."""

    @property
    def coefficients(self) -> Array:
        return np.array([self.mu / 2, 20.0, 0, 0, 0, self.kappa, 0, 0, 1.0])
'''
FORMULA = '''@wp.func
def gent(law: Coefficients, I1: real, I2: real, J: real) -> Derivatives:
    """w = -c10 limit ln(1 - y/limit)."""
    limit = law[1]
    a = wp.exp(-TWO_THIRDS * wp.log(J))
    left = real(1.0) - (a * I1 - real(3.0)) / limit
    y3, dw = -TWO_THIRDS * a / J * I1, law[0] / left
    ddw = dw / left / limit
    d = Derivatives()
    d.value = -law[0] * limit * wp.log(left)
    d.w1 = dw * a
    d.w3 = dw * y3
    d.w11 = ddw * a * a
    d.w13 = ddw * a * y3 - TWO_THIRDS * dw * a / J
    d.w33 = ddw * y3 * y3 + TEN_NINTHS * dw * a * I1 / (J * J)
    return d


@wp.func
def isochoric(law: Coefficients, I1: real, I2: real, J: real) -> Derivatives:
    if law[8] == real(1.0):
        return gent(law, I1, I2, J)
'''
ISOCHORIC = """@wp.func
def isochoric(law: Coefficients, I1: real, I2: real, J: real) -> Derivatives:
"""
SLOPES = """
import numpy as np
import warp as wp
from tacgen.fem.assembly import pattern
from tacgen.fem.elasticity import Elastic
from tacgen.fem.elements import HEX_CORNERS, elements
from tacgen.fem.materials import Toy
from tacgen.fem.projection import Projection
from tacgen.physics import tangents

points, conn = HEX_CORNERS / 2, np.arange(8)[None]
whole = pattern([conn], np.ones((8, 3), bool))
body = Elastic.on(whole, elements(points, conn), Toy(0.1, 4.0))
x, way = points + 0.1 * np.sin(7 * points[:, ::-1] + 1), np.cos(5 * points + 2)
g, h = body.gradient(x), 1e-5
slope = (body.value(x + h * way) - body.value(x - h * way)) / (2 * h)
assert abs(slope - (g * way).sum()) < 1e-7 * np.abs(g).max(), (slope, (g * way).sum())
data = np.zeros(len(whole.indices))
body.add_hessian(x, data, Projection.NONE)
K = np.zeros((24, 24))
K[np.repeat(np.arange(24), np.diff(whole.indptr)), whole.indices] = data
K += np.triu(K, 1).T
bent = (body.gradient(x + h * way) - body.gradient(x - h * way)) / (2 * h)
assert np.abs(bent.ravel() - K @ way.ravel()).max() < 1e-6 * np.abs(bent).max()
made = wp.compile_aot_module(tangents.single().module, arch=90, module_dir="gpu")
print(made[0].stat().st_size)
"""
BALLS = """
import numpy as np
import warp as wp
from tacgen.geometry.analytic_sdf import PearlSdf, SphereSdf
from tacgen.physics import runtime

p = np.random.default_rng(0).uniform(-3, 3, (500, 3))
for found, known in zip(PearlSdf(2.0).distance(p), SphereSdf(2.0).distance(p), strict=True):
    assert np.abs(found - known).max() < 1e-12
made = wp.compile_aot_module(runtime.MODULE, arch=90, module_dir="gpu")
print(made[0].stat().st_size)
"""
LAYER = '''class ToyLayer(IsochoricLayer):
    """A neo-Hookean law by shear and bulk modulus."""

    law: Literal["toy"] = "toy"
    shear_mpa: Positive
    bulk_mpa: Positive

    @property
    def stiffness(self) -> Stiffness:
        return "shear_mpa", 3 * self.shear_mpa

    def material(self) -> "Law":
        from tacgen.fem.materials import Toy

        return Toy(self.shear_mpa, self.bulk_mpa)


def _with_law('''
MINI = (ROOT / "sensors/gelsight_mini.yaml").read_text()
TOYS = {
    "output": Toy(
        (
            Edit("tacgen/outputs/lowest.py", "", OUTPUT),
            Edit("tacgen/outputs/__init__.py", '    "rgb",\n)', '    "rgb",\n    "lowest",\n)'),
        ),
        2,
        "outputs=[force, lowest]",
        ("outputs", "z of the lowest node"),
    ),
    "shape": Toy(
        (
            Edit("tacgen/physics/cores.py", "    wedge = 7\n", "    wedge = 7\n    pearl = 8\n"),
            Edit("tacgen/physics/cores.py", "@wp.func\ndef core_of(", CORE),
            Edit("tacgen/physics/cores.py", "    return wedge(shapes, s, p)\n", BRANCH),
            Edit("tacgen/geometry/analytic_sdf.py", "", SHAPE),
            Edit("tacgen/recipe/indenters.py", "Indenter = Annotated[", INDENTER),
            Edit("tacgen/recipe/indenters.py", "| Mesh,", "| Pearl | Mesh,"),
        ),
        3,
        TOY_SHAPE,
        ("shapes", "A ball of another name"),
    ),
    "law": Toy(
        (
            Edit("tacgen/fem/materials.py", "", LAW),
            Edit("tacgen/physics/laws.py", ISOCHORIC, FORMULA),
            Edit("tacgen/sensor/layers.py", "def _with_law(", LAYER),
            Edit("tacgen/sensor/layers.py", "| YeohLayer,", "| YeohLayer | ToyLayer,"),
        ),
        3,
        TOY_LAW,
    ),
    "sensor": Toy(
        (Edit("sensors/toy.yaml", "", re.sub("(?m)^(name|description): .*", r"\1: toy", MINI)),),
        0,
        "sensor=toy",
        ("sensors", "toy"),
    ),
}


def extended(folder: Path, *names: str) -> int:
    """A copy of what tacgen needs with these things added; how many files of tacgen/ differ."""
    for kind in ("tacgen", "sensors"):
        shutil.copytree(ROOT / kind, folder / kind)  # with compiled modules, which are of these times and sizes
    for kind in ("recipes", "objects"):
        (folder / kind).symlink_to(ROOT / kind)
    for name in names:
        for file, old, new in TOYS[name].edits:
            place = folder / file
            text = place.read_text() if place.exists() else ""
            assert not old or text.count(old) == 1, f"{file}: {old}"
            place.write_text(text.replace(old, new) if old else text + new)
    ours, theirs = ({p.relative_to(f) for p in (f / "tacgen").rglob("*.py")} for f in (ROOT, folder))
    return len(ours ^ theirs) + sum(not cmp(ROOT / p, folder / p, shallow=False) for p in ours & theirs)


def tacgen(folder: Path, *args: str) -> str:
    """The output of the copy's command."""
    (folder / "toy.yaml").write_text(f"{HEAD}  [{PRESS}]\n")
    return ran("-m", "tacgen", *args, folder=folder, tacgen=folder)


# each a copy of the package in processes of its own, which for a shape and a law compiles its kernels anew
LONG = ("shape", "law", "sensor")


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in TOYS])
def test_a_new_thing_touches_as_few_files_as_the_page_says(tmp_path: Path, name: str) -> None:
    toy = TOYS[name]
    assert extended(tmp_path, name) == toy.files
    page = (ROOT / "docs/EXTENDING.md").read_text().split("\n## ")
    begins = ("An output", "A shape", "A material law", "A sensor")
    (part,) = (each for each in page if each.startswith(begins) and name in each[:20])
    told = set(re.findall(r"(?m)^\| `(tacgen/[^`]+)`", part))
    files = {re.sub("lowest", "<name>", edit.file) for edit in toy.edits if edit.file.startswith("tacgen/")}
    assert told == files
    tacgen(tmp_path, "validate", "toy.yaml", "--set", toy.use)
    if toy.listed is not None:
        kind, text = toy.listed
        assert text in tacgen(tmp_path, "list", kind)


@pytest.mark.slow
def test_new_things_work_together(tmp_path: Path) -> None:
    """Slow, since the copy compiles its own code for the new law."""
    extended(tmp_path, *TOYS)
    sets = [word for toy in TOYS.values() for word in ("--set", toy.use)]
    tacgen(tmp_path, "run", "toy.yaml", "-o", "out", *sets)
    with h5py.File(tmp_path / "out" / "scene-00000.h5") as made:
        assert made["/frames/lowest"].attrs["units"] == "mm"
        assert made["/frames/lowest"].shape == (1,)
    assert "nothing found wrong" in tacgen(tmp_path, "check", "out")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "program"), [("law", SLOPES), ("shape", BALLS)])
def test_a_new_formula_runs_on_a_core_and_compiles_for_a_gpu(tmp_path: Path, name: str, program: str) -> None:
    """For sm_90, the H100's, by a machine that has no GPU: a law's forces and tangents, a shape's distances."""
    extended(tmp_path, name)
    assert int(ran("-c", program, folder=tmp_path, tacgen=tmp_path).split()[-1]) > 10_000
