"""Touch into a copy of a LeRobot data set, format v3.0 (https://github.com/huggingface/lerobot).

For each finger, with the prefix that LeRobot plans for touch, `observation.tactile.<finger>.`:

    image                   the sensor's picture, PNG
    force, wrench           on the gel [N], and with the torque about the sensor's origin [N mm]
    markers                 x and y in turn [px]
    expected_error          of the force, over the force [-]
    correction              by which matching moved the object along the sensor's z [mm]
    engine_force            normal force that was asked for, or that the engine reported [N]
    contact, slip, lifted   booleans
    object, note            numbers of the texts in `info` of the feature in meta/info.json; 0: none

Statistics are made as LeRobot makes them, over the rows whose values are known; the deviation of pictures is the true
one (LeRobot 0.4.4 squares pixels in 8 bits). Booleans and numbers of texts have none, since LeRobot's policies
normalise what has statistics, and cannot do it with booleans. All other columns, tasks,
splits and files are as they were: videos are hard links where the file system has them, other files copies.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tacgen.base import regular_file
from tacgen.base.errors import UserError
from tacgen.base.output_file import add
from tacgen.bundle import whole_folder
from tacgen.bundle.image_file import encoded
from tacgen.export.lerobot import DATA_PATH, FILES_PER_FOLDER, PARQUET_FILE_BYTES, TACTILE_PREFIX, statistics
from tacgen.touch.episode import Array, Touch
from tacgen.touch.label_columns import COMPONENTS, LEFT_OUT_NOTE, Felt, columns, distinct, left_out
from tacgen.touch.lerobot_data import INFO_PATH
from tacgen.touch.recording import Recording

FOLDER_KIND = "touch for LeRobot"  # of `whole_folder`
MAX_JSON_BYTES, MAX_PARQUET_BYTES = 2**27, 2**36  # largest files that are read [bytes]
BATCH_ROWS = 256  # rows that are read at once: pictures of a whole file do not fit into memory
# LeRobot's: pictures of an episode in its statistics, at least and at most, the power of the rows between, and the size
# from which pictures are thinned out, to about which size [px]
MIN_SAMPLES, MAX_SAMPLES, SAMPLES_POWER = 100, 10_000, 0.75
LARGE_IMAGE_PX, THINNED_IMAGE_PX = 300, 150
PNG_LEVEL = 4  # of compression: files of noisy pictures are as small as by 6, Pillow's own, in half the time
MAX_KEPT_PICTURES = 64  # files, and statistics of as many sets of pictures, that may be needed again
Statistics = dict[str, dict[str, list]]
Key = TypeVar("Key")
Value = TypeVar("Value")


def write(source: Recording, felt: Felt, out: Path, *, overwrite: bool) -> list[Path]:
    """Write the copy into the folder `out`, which appears when it is complete. Returns the files.

    Rows of episodes that are not among `felt` get nan and a note.

    Args:
        overwrite: `out` may hold such a copy, unchanged since.

    Raises:
        UserError: touch is in the data set, its rows are not those of the episodes, or `out` is in the way.
    """
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise UserError("touch in a LeRobot data set needs PyArrow: pip install 'tacgen[lerobot]'") from None
    refuse(source, out, overwrite=overwrite)
    given, info = source.path.resolve(), _json(source.path / INFO_PATH)
    like, *_ = every = [fingers for _, fingers in felt.values()]
    texts = {"object": distinct(text for fingers in every for touch in fingers for text in touch.touched)}
    unfelt = [LEFT_OUT_NOTE] if len(felt) < len(source) else []
    texts["note"] = distinct([*(text for fingers in every for touch in fingers for text in touch.note), *unfelt])
    new = {name: value for touch in like for name, value in _features(touch, texts).items()}
    if there := sorted(new.keys() & info["features"].keys()):
        raise UserError(f"{source.path}: has {there[0]} already")
    with whole_folder.written(out, FOLDER_KIND) as folder:
        _copy(given, folder)
        rows, stats = _data(given, folder, felt, like, texts, new)
        _episodes(given, folder, rows)
        whole = _json(given / "meta/stats.json") if (given / "meta/stats.json").exists() else {}
        whole |= _aggregated([stats[index] for index in sorted(stats)])
        template = DATA_PATH.replace("{:", "{chunk_index:", 1).replace("{:", "{file_index:", 1)
        info = info | {"features": info["features"] | new, "data_path": template}
        for name, content in (("stats", whole), ("info", info)):
            add(folder / "meta" / f"{name}.json", json.dumps(content, indent=4, ensure_ascii=False) + "\n")
        made = sorted(path.relative_to(folder) for path in folder.rglob("*") if path.is_file())
    return [out / path for path in made]


def refuse(source: Recording, out: Path, *, overwrite: bool) -> None:
    """UserError if the copy cannot be in the folder `out`; to be called before long work, too."""
    given, where = source.path.resolve(), out.resolve()
    if where.is_relative_to(given) or given.is_relative_to(where):
        raise UserError(f"{out}: the copy must be outside of the data set {source.path}")
    if not overwrite and out.is_dir() and any(out.iterdir()):
        raise UserError(f"{out}: is there already; --overwrite replaces it")


def _json(path: Path) -> Any:
    try:
        return json.loads(regular_file.read_bytes(path, MAX_JSON_BYTES))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: is not JSON: {error}") from None


def _features(touch: Touch, texts: dict[str, list[str]]) -> dict[str, dict[str, Any]]:
    """LeRobot's description of each new column of a finger."""
    image = {"dtype": "image", "shape": list(touch.image(0).shape), "names": ["height", "width", "channels"]}
    features: dict[str, dict[str, Any]] = {"image": image}
    for name, values in columns(touch).items():
        features[name] = {"dtype": values.dtype.name, "shape": [values.shape[1]], "names": COMPONENTS.get(name)}
    for name, known in texts.items():
        features[name] = {"dtype": "int64", "shape": [1], "names": None, "info": {"texts": known}}
    return {f"{TACTILE_PREFIX}{touch.finger}.{name}": feature for name, feature in features.items()}


def _copy(given: Path, folder: Path) -> None:
    """All files but the tables and metadata that are written anew."""
    for path in sorted(given.rglob("*")):
        place = path.relative_to(given)
        anew = place.parts[0] == "data" or place.parts[:2] == ("meta", "episodes")
        ours = place.as_posix() in (INFO_PATH, "meta/stats.json", whole_folder.EXPORT_LIST_FILE)
        if path.is_dir() or (anew and path.suffix == ".parquet") or ours:
            continue
        target, real = folder / place, path.resolve()  # a cache of the Hugging Face hub has links
        target.parent.mkdir(parents=True, exist_ok=True)
        if place.parts[0] == "videos":
            try:
                os.link(real, target)
                continue
            except OSError:  # another file system, or one without hard links
                pass
        shutil.copyfile(real, target)


def _data(
    given: Path, folder: Path, felt: Felt, like: Sequence[Touch], texts: dict[str, list[str]], new: dict[str, Any]
) -> tuple[dict[int, dict[str, Any]], dict[int, Statistics]]:
    """Write the tables of rows; by episode what its row of metadata gets, and the statistics of its touch."""
    from pyarrow import parquet

    rows: dict[int, dict[str, Any]] = {}
    stats: dict[int, Statistics] = {}
    writer, path, number, pictures = None, folder, -1, _Pictures()
    try:
        for begins, index, table in _tables(given):
            n = table.num_rows
            episode, fingers = felt.get(index, (None, [left_out(touch, n) for touch in like]))
            if index in rows or (episode is not None and len(episode) != n):
                count = len(fingers[0].touched)
                raise UserError(f"{given}: episode {index} has other rows than the {count} with touch")
            stats[index] = {}
            for touch in fingers:
                arrays, own = _columns(touch, texts, pictures)
                stats[index] |= own
                for name, array in arrays.items():
                    table = table.append_column(name, array)
            if writer is None or begins or path.stat().st_size > PARQUET_FILE_BYTES:
                if writer is not None:
                    writer.close()
                number += 1
                path = folder / DATA_PATH.format(*divmod(number, FILES_PER_FOLDER))
                path.parent.mkdir(parents=True, exist_ok=True)
                writer = parquet.ParquetWriter(path, _described(table.schema, new), compression="snappy")
            writer.write_table(table.replace_schema_metadata(writer.schema.metadata))
            chunk, file = divmod(number, FILES_PER_FOLDER)
            told = {f"stats/{name}/{kind}": v for name, kinds in stats[index].items() for kind, v in kinds.items()}
            rows[index] = {"data/chunk_index": chunk, "data/file_index": file, **told}
    finally:
        if writer is not None:
            writer.close()
    if missing := sorted(felt.keys() - rows.keys()):
        raise UserError(f"{given}: has no rows of episode {missing[0]}")
    return rows, stats


def _tables(given: Path) -> Iterator[tuple[bool, int, Any]]:
    """The rows of each episode: whether a file of the original begins with them, the episode's index, its table."""
    import pyarrow as pa
    from pyarrow import parquet

    for path in sorted((given / "data").glob("*/*.parquet")):
        with regular_file.opened(path, MAX_PARQUET_BYTES) as file:
            held: list[Any] = []
            before, begins = -1, True
            for batch in parquet.ParquetFile(file).iter_batches(BATCH_ROWS):
                of = batch.column("episode_index").to_numpy()
                edges = [0, *(np.flatnonzero(np.diff(of)) + 1), len(of)]
                for start, stop in pairwise(edges):
                    if held and of[start] != before:
                        yield begins, before, pa.Table.from_batches(held)
                        held, begins = [], False
                    held.append(batch.slice(start, stop - start))
                    before = int(of[start])
            if held:
                yield begins, before, pa.Table.from_batches(held)


def _columns(touch: Touch, texts: dict[str, list[str]], pictures: "_Pictures") -> tuple[dict[str, Any], Statistics]:
    """Arrow arrays of a finger's columns, and the statistics of those that have them."""
    import pyarrow as pa

    prefix, count = f"{TACTILE_PREFIX}{touch.finger}.", len(touch.touched)
    files, statistics_of_image = pictures.of(touch)
    picture = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
    arrays: dict[str, Any] = {"image": pa.array([{"bytes": file, "path": None} for file in files], picture)}
    stats = {"image": statistics_of_image}
    for name, values in columns(touch).items():
        flat = pa.array(values.ravel())
        arrays[name] = flat if values.shape[1] == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])
        if values.dtype != bool:
            stats[name] = _statistics(values)
    for name, said in (("object", touch.touched), ("note", touch.note)):
        numbers = {text: k for k, text in enumerate(texts[name])}
        arrays[name] = pa.array([numbers[said[k]] for k in range(count)], pa.int64())
    return {prefix + name: array for name, array in arrays.items()}, {prefix + k: v for k, v in stats.items()}


class _Pictures:
    """Files and statistics of pictures. Most rows show the untouched sensor, or black: each distinct picture is encoded
    once, and the same pictures have their statistics computed once, as far as they are still kept."""

    def __init__(self) -> None:
        self.files: dict[bytes, bytes] = {}  # by the digest of the pixels
        self.statistics: dict[tuple[bytes, ...], dict[str, list]] = {}

    def of(self, touch: Touch) -> tuple[list[bytes], dict[str, list]]:
        """PNG files of all rows, and the statistics of those that LeRobot samples."""
        n = len(touch.touched)
        sampled = np.linspace(0, n - 1, max(min(MIN_SAMPLES, n), min(int(n**SAMPLES_POWER), MAX_SAMPLES)))
        wanted, files, samples = set(np.round(sampled).astype(int).tolist()), list[bytes](), dict[bytes, Array]()
        last, digest, order = None, b"", list[bytes]()
        for k in range(n):
            image = touch.image(k)
            if image is not last:
                last = image
                digest = hashlib.sha256(repr(image.shape).encode() + np.ascontiguousarray(image).data).digest()
            files.append(_kept(self.files, digest, partial(encoded, image, "PNG", compress_level=PNG_LEVEL)))
            if k in wanted:
                order.append(digest)
                samples.setdefault(digest, _thinned(image))
        made = partial(_image_statistics, np.array([samples[each] for each in order]))
        return files, _kept(self.statistics, tuple(order), made)


def _kept(known: dict[Key, Value], key: Key, make: Callable[[], Value]) -> Value:
    """The value of a key, made where it is not among those that were asked for last."""
    known[key] = value = known.pop(key) if key in known else make()
    if len(known) > MAX_KEPT_PICTURES:
        del known[next(iter(known))]
    return value


def _thinned(image: Array) -> Array:
    """A picture (h, w, 3) as LeRobot samples it."""
    high, wide = image.shape[:2]
    step = max(high, wide) // THINNED_IMAGE_PX if max(high, wide) >= LARGE_IMAGE_PX else 1
    return image[::step, ::step].copy()


def _image_statistics(samples: Array) -> dict[str, list]:
    """Statistics of pictures (s, h, w, 3), of each colour in [0, 1]."""
    found = statistics([{"": samples.reshape(-1, 3) / 255}])[""]
    colours = {name: np.reshape(value, (3, 1, 1)).tolist() for name, value in found.items() if name != "count"}
    return colours | {"count": [len(samples)]}


def _statistics(values: Array) -> dict[str, list]:
    """Statistics of rows (n, k) whose values are all known; zeros and a count of 0 where there is none."""
    known = values[np.isfinite(values).all(axis=1)]
    found = statistics([{"": known if len(known) else np.zeros((1, values.shape[1]))}])[""]
    return found | {"count": [len(known)]}


def _aggregated(episodes: Sequence[Statistics]) -> Statistics:
    """Statistics of all episodes from those of each, as LeRobot's `aggregate_stats` has them: quantiles are means."""
    whole: Statistics = {}
    for name in episodes[0]:
        known = [e[name] for e in episodes if e[name]["count"][0]] or [episodes[0][name]]
        parts = {kind: np.array([stats[kind] for stats in known], float) for kind in known[0]}
        counts = parts.pop("count").ravel()
        weights = counts / counts.sum() if counts.sum() else np.full(len(counts), 1 / len(counts))
        found = {kind: np.tensordot(weights, values, 1) for kind, values in parts.items()}
        spread = parts["std"] ** 2 + (parts["mean"] - found["mean"]) ** 2
        found |= {"min": parts["min"].min(0), "max": parts["max"].max(0)}
        found["std"] = np.sqrt(np.tensordot(weights, spread, 1))
        whole[name] = {kind: value.tolist() for kind, value in found.items()} | {"count": [int(counts.sum())]}
    return whole


def _described(schema: Any, new: dict[str, dict[str, Any]]) -> Any:
    """A schema whose note for Hugging Face's `datasets`, where there is one, has the new columns."""
    metadata = dict(schema.metadata or {})
    if b"huggingface" not in metadata:
        return schema
    note = json.loads(metadata[b"huggingface"])
    for name, feature in new.items():
        kind: dict[str, Any] = {"dtype": feature["dtype"], "_type": "Value"}
        if feature["dtype"] == "image":
            kind = {"_type": "Image"}
        elif feature["shape"] != [1]:
            kind = {"feature": kind, "length": feature["shape"][0], "_type": "Sequence"}
        note.setdefault("info", {}).setdefault("features", {})[name] = kind
    return schema.with_metadata(metadata | {b"huggingface": json.dumps(note).encode()})


def _episodes(given: Path, folder: Path, rows: dict[int, dict[str, Any]]) -> None:
    """The tables of episodes, with the files that hold their rows and the statistics of their touch."""
    import pyarrow as pa
    from pyarrow import parquet

    for path in sorted((given / "meta/episodes").glob("*/*.parquet")):
        with regular_file.opened(path, MAX_PARQUET_BYTES) as file:
            table = parquet.read_table(file)
        numbers = table.column("episode_index").to_pylist()
        if missing := sorted(set(numbers) - rows.keys()):
            raise UserError(f"{given}: has no rows of episode {missing[0]}")
        for name in rows[numbers[0]]:
            values = pa.array([rows[number][name] for number in numbers])
            at = table.schema.get_field_index(name)
            table = table.append_column(name, values) if at < 0 else table.set_column(at, name, values)
        target = folder / path.relative_to(given)
        target.parent.mkdir(parents=True, exist_ok=True)
        parquet.write_table(table, target, compression="snappy")
