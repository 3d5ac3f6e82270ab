"""Every interval becomes a scene: tables of poses, a recipe for each finger and object, and one plan of all of them."""

import hashlib
import json
import re
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tacgen.base import output_file
from tacgen.base.errors import UserError
from tacgen.geometry.gel import GelBody
from tacgen.geometry.pose import Pose
from tacgen.recipe import assets, checks, plan, scene_of_row
from tacgen.recipe.checks import MAX_EDGE_PER_THICKNESS
from tacgen.recipe.model import QUALITIES, Grasp
from tacgen.recipe.plan import Plan
from tacgen.recipe.row import Row, scene_seed
from tacgen.recipe.trajectory import Placement, Segment, Start
from tacgen.recipe.trajectory_checks import Folders
from tacgen.replay import selection, written_recipe
from tacgen.replay.preparation import WRITTEN_KEYS
from tacgen.replay.selection import FACE_SPACING_MM, RecordedBody
from tacgen.sensor.yaml_source import Tree
from tacgen.touch import grasps, intervals
from tacgen.touch.episode import EpisodeLog, Finger, Thing
from tacgen.touch.intervals import AtFinger, Interval, Rate
from tacgen.touch.recording import Recording

TABLE_KEY = "trajectory[0].replay.file"
UNTOUCHED_FRAMES = 8  # pictures of an untouched sensor, which differ by the camera's noise
UNTOUCHED_CLEARANCE_MM = 10.0  # height of a ball over the gel that it never touches [mm]
MAX_CONTACT_UNKNOWNS = 700  # of contact at once, which are solved for as one dense system: a frame takes 0.1 s
UNKNOWNS_PER_NODE = 3  # coordinates of a node of the face, each with an area of an edge squared [-]
USUAL_DEPTH_MM = 0.5  # depth of a contact whose recorded pose hardly touches [mm]
MAX_SAMPLED_POSES = 12  # of an interval, and intervals of an object, at which the area in contact is looked at
MATCHES = ("pose", "force", "grip")


@dataclass(frozen=True)
class TouchChoice:
    """Options: which contacts are solved, and how.

    match: one of MATCHES: whether poses are kept, forces, or the grip of both fingers; near_mm: as of
    `intervals.contacts`; friction between objects and gels [-]; quality: as in a recipe; sets: overrides of every
    recipe, as on the command line.
    """

    match: str = "pose"
    near_mm: float = 1.0
    rate: Rate = field(default_factory=Rate)
    friction: float = 0.6
    quality: str = "draft"
    sets: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.match not in MATCHES:
            raise UserError(f"--match {self.match}: must be one of {', '.join(MATCHES)}")
        if not self.near_mm > 0:
            raise UserError(f"--near-mm {self.near_mm:g}: must be more than 0")
        for key in WRITTEN_KEYS:
            if text := next((text for text in self.sets if text.strip().startswith(key)), ""):
                raise UserError(f"--set {text}: {key} comes from the episodes")


@dataclass(frozen=True)
class TouchScenes:
    """The scenes of some episodes. scenes: a line of the plan -> its interval; refused: intervals that cannot be
    solved, with the reason; untouched: name of a finger -> the scene of its sensor without contact."""

    plan: Plan
    episodes: tuple[EpisodeLog, ...]
    contacts: tuple[tuple[AtFinger, ...], ...]  # of each episode, at each finger
    scenes: Mapping[int, Interval]
    refused: tuple[tuple[Interval, str], ...]
    untouched: Mapping[str, int]
    notes: tuple[str, ...]


def prepare(source: Recording, fingers: Sequence[Finger], asked: TouchChoice, folder: Path, chosen: range | None = None,
            *, overwrite: bool = False) -> TouchScenes:  # fmt: skip
    """Find the contacts of a source's episodes, or of the `chosen` ones, and write the recipes of their scenes.

    An episode that cannot be read is left out, with a note.

    Raises:
        UserError: no episode can be read, nothing comes near a gel, a sensor or an object is not valid, or a file in
            `folder` is in the way.
    """
    bases = {finger.name: _base(finger, asked) for finger in fingers}
    gels = {name: scene_of_row.gel_of(row.sensor, row.solid_path) for name, row in bases.items()}
    things = {name: (thing, intervals.body_of(thing)) for name, thing in source.things.items()}
    notes, episodes = list[str](), list[EpisodeLog]()
    contacts = list[tuple[AtFinger, ...]]()
    for episode in _readable(source, chosen, notes):
        episodes.append(episode)
        lost = ", ".join(name for name in things if not intervals.recorded(episode, name))
        notes += [f"episode {episode.name}: {lost}: no pose is recorded: its touch is not known"] if lost else []
        contacts.append(tuple(intervals.contacts(episode, finger, things, gels[finger.name], asked.near_mm)
                              for finger in fingers))  # fmt: skip
    if not episodes:
        raise UserError(notes or [f"{source.path}: holds no episode of those that are asked for"])
    if not any(at.intervals or any(at.note) for each in contacts for at in each):
        raise UserError([*notes, _nowhere(source, episodes, fingers, things, gels)])
    found, refused = [one for each in contacts for at in each for one in at.intervals], list[tuple[Interval, str]]()
    known = {episode.index: (episode, each) for episode, each in zip(episodes, contacts, strict=True)}
    if asked.match == "grip":
        if len(fingers) != 2:
            raise UserError(f"--match grip: needs two fingers, and {len(fingers)} are given by --sensor")
        found = []
        for episode, each in known.values():
            held, wrong = grasps.paired(episode, each)
            found += held
            refused += wrong
    groups: dict[tuple[Any, ...], list[Interval]] = {}
    for interval in (intervals.at_rate(one, asked.rate) for one in found):
        down = known[interval.episode][0].gravity if interval.other else ()
        groups.setdefault((interval.finger.name, interval.thing.body, down), []).append(interval)
    writer = _Writer(folder, asked, overwrite, notes, known)
    plans, order, untouched = list[Plan](), list[Interval | None](), dict[str, int]()
    for finger in fingers:
        same = next((other for other in fingers if other.sensor == finger.sensor), finger)
        if same is finger:
            plans.append(writer.untouched(finger, bases[finger.name]))
            order.append(None)
            untouched[finger.name] = len(order) - 1
        untouched[finger.name] = untouched[same.name]
    for (name, *_), group in groups.items():
        fine, wrong = writer.possible(group, things[group[0].thing.body][1], bases[name])
        refused += wrong
        if fine:
            plans.append(writer.group(fine, things[group[0].thing.body][1], bases[name]))
            order += fine
    scenes = {k: interval for k, interval in enumerate(order) if interval is not None}
    return TouchScenes(
        joined(plans, source.path.name), tuple(episodes), tuple(contacts), scenes, tuple(refused), untouched,
        tuple(notes),
    )  # fmt: skip


def _readable(source: Recording, chosen: range | None, notes: list[str]) -> Iterator[EpisodeLog]:
    """The episodes of a source that can be read, and a note on each other one."""
    for number in range(len(source)) if chosen is None else chosen:
        if number < len(source):
            try:
                yield source.episode(number)
            except UserError as error:
                notes.append("; ".join(error.lines))


def _nowhere(
    source: Recording, episodes: Sequence[EpisodeLog], fingers: Sequence[Finger],
    things: Mapping[str, tuple[Thing, RecordedBody]], gels: Mapping[str, GelBody],
) -> str:  # fmt: skip
    """The error where no object comes near a gel: the closest approach, and where to look."""
    each = [(intervals.approach(episode, finger, things, gels[finger.name]), finger, episode)
            for episode in episodes for finger in fingers]  # fmt: skip
    known = [(told, finger, episode) for told, finger, episode in each if told is not None]
    if not known:
        return f"{source.path}: there is no object but the bodies of the sensors: name one by --object"
    (gap, row, name), finger, episode = min(known, key=lambda one: one[0])
    return (
        f"{source.path}: nothing comes near a gel: closest is {name}, about {gap:.3g} mm from {finger.name} in row"
        f" {row} of episode {episode.name}: check --object, the body in --sensor, --mount and units"
    )


def _recipe(finger: Finger, name: str, asked: TouchChoice, outputs: Sequence[str]) -> dict[str, Any]:
    """The keys that all recipes of a finger have."""
    return {
        "tacgen": 1, "name": re.sub(r"[^A-Za-z0-9._-]+", "-", f"touch-{name}")[:100], "sensor": _sensor(finger),
        "contact": {"friction": asked.friction}, "outputs": list(outputs), "quality": asked.quality, "may_miss": True,
    }  # fmt: skip


def _sensor(finger: Finger) -> str:
    """The sensor as a recipe in any folder names it."""
    shipped = finger.sensor in assets.list_sensors()
    return finger.sensor if shipped else str(assets.sensor_path(finger.sensor).resolve())


def _base(finger: Finger, asked: TouchChoice) -> Row:
    """The scene of a finger's sensor under a ball that does not touch it. Raises UserError: the sensor is not valid."""
    ball = {"indenter": {"shape": "sphere", "radius_mm": 4.0}, "start": {"clearance_mm": UNTOUCHED_CLEARANCE_MM}}
    hold = {"trajectory": [{"hold": {"frames": UNTOUCHED_FRAMES}}]}
    recipe = _recipe(finger, f"{finger.name}-untouched", asked, ["force", "events"]) | ball | hold
    (row,) = plan.load(Tree(recipe), asked.sets).rows
    if not row.sensor.lit:
        raise UserError(f"--sensor {finger.name}: {row.sensor.name} has no light, and so no pictures: take another")
    shown = [*(["markers"] if row.sensor.markers else []), "rgb"]
    (row,) = plan.load(Tree(recipe | {"outputs": ["force", "events", *shown]}), asked.sets).rows
    return row


@dataclass(frozen=True)
class _Writer:
    """Writes the tables and recipes of scenes into a folder."""

    folder: Path
    asked: TouchChoice
    overwrite: bool
    notes: list[str]
    episodes: Mapping[int, tuple[EpisodeLog, tuple[AtFinger, ...]]]

    def untouched(self, finger: Finger, base: Row) -> Plan:
        """The plan of a sensor that nothing touches."""
        keys = _recipe(finger, f"{finger.name}-untouched", self.asked, _outputs(base))
        still = base.recipe.document()
        more = {key: still[key] for key in ("indenter", "start", "trajectory")}
        return self._written(f"{finger.name}-untouched.yaml", keys | more, {})

    def possible(
        self, group: Sequence[Interval], body: RecordedBody, base: Row
    ) -> tuple[list[Interval], list[tuple[Interval, str]]]:
        """The intervals of one finger and object up to the first frame that cannot be solved, whose tables are written;
        and the frames from there on, with the reason."""
        fine, wrong = list[Interval](), list[tuple[Interval, str]]()
        for interval in group:

            def problem(count: int, interval: Interval = interval) -> str:
                return self._problem(_part(interval, 0, count), body, base)

            few = len(interval.log)
            if problem(few):
                few = bisect_left(range(few), True, key=lambda k: bool(problem(k + 1)))  # the last one is known to fail
                wrong.append((_part(interval, few, None), problem(few + 1)))
            if few:
                fine.append(_part(interval, 0, few))
                text = self._text(fine[-1])
                written_recipe.write({_table(interval): text}, self.folder, (), self.overwrite)
        return fine, wrong

    def _problem(self, interval: Interval, body: RecordedBody, base: Row) -> str:
        """Why an interval cannot be solved, "" if it can."""
        with TemporaryDirectory() as name:
            path = Path(name) / _table(interval)
            output_file.put(path, self._text(interval).encode())
            move = Segment.model_validate({"replay": {"file": path.name, **self._move(interval, body)}})
            held = Grasp.model_validate(self._grasp(interval)) if interval.other else None
            more = {"trajectory": (move,), "indenter": body.indenter, "start": Start(), "grasp": held}
            folders: Folders = {("trajectory", 0, "replay", "file"): path.parent}
            problems = checks.recipe_problems(base.recipe.model_copy(update=more), base.sensor, folders)
        return problems[0].message.removeprefix(f"{_table(interval)}: ") if problems else ""

    def _text(self, interval: Interval) -> str:
        if interval.other is None:
            return written_recipe.table(interval.log)
        return grasps.table(interval, *self.episodes[interval.episode])

    def _grasp(self, interval: Interval) -> dict[str, Any]:
        assert interval.other is not None
        gravity = self.episodes[interval.episode][0].gravity
        return grasps.block(interval, gravity, _sensor(interval.other))

    def group(self, group: Sequence[Interval], body: RecordedBody, base: Row) -> Plan:
        """The plan of the intervals of one finger and object, in order."""
        finger, tables = group[0].finger, [_table(one) for one in group]
        name = tables[0].removesuffix(".csv")
        move = {key: value.model_dump(mode="json") if isinstance(value, Placement) else value
                for key, value in self._move(group[0], body).items()}  # fmt: skip
        keys = _recipe(finger, name, self.asked, _outputs(base))
        keys |= {
            "indenter": body.indenter.model_dump(mode="json", exclude_none=True),
            "trajectory": [{"replay": {"file": tables[0], **move}}],
        }
        keys["quality"], area = self._quality(group, body, base)
        if keys["quality"] != self.asked.quality:
            self.notes.append(
                f"{group[0].place}: about {area:.0f} mm^2 of the gel are touched at once: edges"
                f" of {keys['quality']['edge_mm']:g} mm, for which labels say the expected error"
            )
        if group[0].other is not None:
            keys["grasp"] = self._grasp(group[0])
        vary = {"vary": {"method": "grid", "over": {TABLE_KEY: {"choice": tables}}}}
        return self._written(f"{name}.yaml", keys, vary)

    def _quality(self, group: Sequence[Interval], body: RecordedBody, base: Row) -> tuple[Any, float]:
        """The quality for a group, and the area [mm^2] that it touches at once: with edges so long that the contact has
        about MAX_CONTACT_UNKNOWNS."""
        asked = QUALITIES.get(self.asked.quality)
        if asked is None or any(text.strip().startswith("quality") for text in self.asked.sets):
            return self.asked.quality, 0.0
        gel = scene_of_row.gel_of(base.sensor, base.solid_path)
        face = selection.face_points(gel)
        some = group[:: -(-len(group) // MAX_SAMPLED_POSES)]
        area = 0.0
        for one in some:
            rows = one.log.some(np.arange(len(one.log))[:: -(-len(one.log) // MAX_SAMPLED_POSES)])
            for pose in selection.relative(rows, one.finger.mount, body.pose):
                gap = body.distance(Pose.of(pose).local(face))
                if gap.min() <= self.asked.near_mm:
                    area = max(area, FACE_SPACING_MM**2 * float((gap <= max(0.0, gap.min() + USUAL_DEPTH_MM)).sum()))
        edge = round(float(np.sqrt(UNKNOWNS_PER_NODE * area / MAX_CONTACT_UNKNOWNS)), 2)
        edge = min(edge, MAX_EDGE_PER_THICKNESS * gel.thickness)
        if edge <= asked.edge_mm or self.asked.quality == "reference":
            return self.asked.quality, area
        dhat = float(f"{asked.dhat_mm * edge / asked.edge_mm:.3g}")
        return {"edge_mm": edge, "dhat_mm": dhat, "spp": asked.spp}, area

    def _move(self, interval: Interval, body: RecordedBody) -> dict[str, Any]:
        if interval.other is not None:
            return {"match": "grip"}
        match = {} if self.asked.match == "pose" else {"match": self.asked.match}
        return {"sensor_pose": interval.finger.mount, "indenter_pose": body.pose, **match}

    def _written(self, name: str, keys: Mapping[str, Any], vary: Mapping[str, Any]) -> Plan:
        text = "".join(f"{key}: {json.dumps(value)}\n" for key, value in {**keys, **vary}.items())
        written_recipe.write({name: text}, self.folder, (), self.overwrite)
        return plan.load(self.folder / name, self.asked.sets)


def _part(interval: Interval, first: int, end: int | None) -> Interval:
    return replace(interval, log=interval.log.some(np.arange(len(interval.log))[first:end]))


def _outputs(base: Row) -> list[str]:
    return [str(name) for name in base.recipe.document()["outputs"]]


def _file_name(name: str) -> str:
    """A name as part of a file's, which no other name becomes."""
    safe = re.sub(r"[^A-Za-z0-9_-]+", "_", name)
    return safe if safe == name else f"{safe}-{hashlib.sha256(name.encode()).hexdigest()[:6]}"


def _table(interval: Interval) -> str:
    first, _ = interval.rows
    name = "-".join([*(finger.name for finger in interval.fingers), interval.thing.body])
    return _file_name(name) + f"-{interval.episode:06d}-{first:06d}.csv"


def joined(plans: Sequence[Plan], name: str) -> Plan:
    """The scenes of several plans as one, numbered through."""
    rows = [row for each in plans for row in each.rows]
    numbered = [replace(row, index=k, name=f"scene-{k:05d}", seed=scene_seed(0, k)) for k, row in enumerate(rows)]
    frames = [count for each in plans for count in each.frames]
    told = tuple(dict.fromkeys(text for each in plans for text in each.warnings))
    sensors = tuple(dict.fromkeys(sensor for each in plans for sensor in each.sensors))
    inputs = hashlib.sha256("".join(each.inputs for each in plans).encode()).hexdigest()
    return Plan(name, numbered, frames, (TABLE_KEY,), told, sensors, inputs)


def shard(whole: Plan, part: tuple[int, int]) -> Plan:
    """Part i of N of a plan, as of `plan.load`."""
    some = slice(part[0], None, part[1])
    return replace(whole, rows=whole.rows[some], frames=whole.frames[some])
