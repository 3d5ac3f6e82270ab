"""The probe: a child that dies must cost its parent nothing, and an answer is only asked for once."""

import os
from pathlib import Path

import pytest

from tacgen.render import mitsuba_variants


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("TACGEN_CACHE_DIR", str(tmp_path / "cache"))
    mitsuba_variants._asked.cache_clear()
    yield
    mitsuba_variants._asked.cache_clear()


def test_scalar_renders_and_a_wrong_llvm_library_is_a_no_and_not_the_end_of_the_process(tmp_path):
    found = mitsuba_variants.probe(mitsuba_variants.SCALAR_VARIANT)
    assert found.works, found.note
    wrong = tmp_path / "libLLVM.so"
    wrong.write_bytes(b"not a library")
    found = mitsuba_variants.probe(mitsuba_variants.LLVM_VARIANT, str(wrong))
    assert not found.works
    assert found.note


def test_a_child_that_aborts_is_a_no(monkeypatch):
    probe = "import os; os.write(2, b'LLVM ERROR: boom'); os.abort()"  # written at once, as LLVM does
    monkeypatch.setattr(mitsuba_variants, "PROBE_PROGRAM", probe)
    found = mitsuba_variants.probe(mitsuba_variants.LLVM_VARIANT, "any.so")
    assert found == (mitsuba_variants.LLVM_VARIANT, "any.so", False, "killed by signal 6: LLVM ERROR: boom")


def test_a_child_that_hangs_is_a_no(monkeypatch):
    monkeypatch.setattr(mitsuba_variants, "PROBE_PROGRAM", "import time; time.sleep(60)")
    monkeypatch.setattr(mitsuba_variants, "PROBE_TIMEOUT_S", 0.3)
    assert mitsuba_variants.probe(mitsuba_variants.LLVM_VARIANT).note == "TimeoutExpired"


def test_an_answer_is_kept_until_the_library_changes(tmp_path, monkeypatch):
    library = tmp_path / "libLLVM-19.so"
    library.write_bytes(b"1")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(library))
    monkeypatch.setattr(mitsuba_variants, "LIBRARY_FOLDERS", ())
    asked = []

    def probe(variant, found=""):
        asked.append(found)
        return mitsuba_variants.VariantProbe(variant, found, True, "renders")

    monkeypatch.setattr(mitsuba_variants, "probe", probe)
    assert mitsuba_variants._llvm().library == str(library)
    mitsuba_variants._asked.cache_clear()  # as in a new process
    assert mitsuba_variants._llvm().works
    assert asked == [str(library)]
    os.utime(library, ns=(1, 1))
    mitsuba_variants._llvm()
    assert len(asked) == 2


def test_a_damaged_answer_is_asked_again(tmp_path, monkeypatch):
    monkeypatch.setattr(mitsuba_variants, "probe", lambda v, x="": mitsuba_variants.VariantProbe(v, x, True, "renders"))
    mitsuba_variants._remembered(mitsuba_variants.SCALAR_VARIANT, "")
    (kept,) = Path(tmp_path, "cache", "variants").iterdir()
    kept.write_text("{broken")
    mitsuba_variants._asked.cache_clear()
    assert mitsuba_variants._remembered(mitsuba_variants.SCALAR_VARIANT, "").works
    assert b"renders" in kept.read_bytes()


def test_without_llvm_and_gpu_the_scalar_variant_is_taken(monkeypatch):
    for name in ("_cuda", "_llvm"):
        monkeypatch.setattr(mitsuba_variants, name, lambda: mitsuba_variants.VariantProbe("any", "", False, "no"))
    assert mitsuba_variants.best().variant == mitsuba_variants.SCALAR_VARIANT


def test_a_missing_home_is_replaced(monkeypatch):
    monkeypatch.delenv("HOME", raising=False)
    assert Path(mitsuba_variants.environment()["HOME"]).is_dir()
