"""The functions of the native FMU by C calls: what tools do with it, and what they should not.

Where it is unpacked and how its resources are named, how steps, states and messages are used, and
what it says where its files are not as they were. Each case was reported of some FMU or tool.
"""

from __future__ import annotations

import ctypes
import math
import os
import shutil
import struct
import zlib
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from fmpy import extract, read_model_description

from tests.fmu.hostile import ERROR, FUNCTIONS, OK, WARNING, Callbacks, State
from tests.fmu.native import HOST
from tests.places import SCREENS
from vibroscreen import ScreenConfig
from vibroscreen_fmu.native.fmu import write_native_fmu
from vibroscreen_fmu.native.tables import HEAD

LOGGER = ctypes.CFUNCTYPE(
    None,
    *(ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p),
    ctypes.c_char_p,
)
LAST_SUCCESSFUL_TIME = 2
SHEET = Path("resources", "screen.bin")
ODD = (
    *("a (1)", "R&D", "a,b", "a=b", "a@b", "a[1]", "a'b", "a%b", "a%20b", "100%s%n", "a b", "a;b"),
    *("a#b", "a+b", "a?b", "a{name}b", "Sieb für Körner", "筛分机", 'a"b', "a\\b", "~a$b"),
)


class Host:
    """The library of an FMU that is unzipped to a folder, and what it logs."""

    def __init__(self, fmu: Path, library: Path | str | None = None) -> None:
        description = read_model_description(str(fmu))
        self.fmu, self.guid = fmu, description.guid.encode()
        self.reference = {v.name: v.valueReference for v in description.modelVariables}
        (found,) = (fmu / "binaries" / HOST).glob("VibratingScreen.*")
        self.c = ctypes.CDLL(str(library or found))
        for name, (result, arguments) in FUNCTIONS.items():
            function = getattr(self.c, name)
            function.restype, function.argtypes = result, arguments
        self.said: list[tuple[int, str, str, str]] = []
        # The library asks for no memory of its host.
        self._logger, self.callbacks = LOGGER(self._log), Callbacks()
        ctypes.memmove(ctypes.byref(self.callbacks), ctypes.byref(self._logger), 8)

    def _log(self, _: Any, __: bytes, status: int, kind: bytes, form: bytes, text: bytes) -> None:
        # As printf does it: a text that is taken for a format stands for itself.
        assert form == (b"%s" if b"%" in text else text)
        self.said.append((status, kind.decode(), text.decode(errors="replace"), form.decode()))

    @property
    def text(self) -> str:
        """What was said last."""
        return self.said[-1][2]

    def make(
        self, location: bytes | None = None, guid: bytes | None = None, name: bytes = b"screen"
    ) -> int | None:
        """An instance that has not started, or None."""
        given = ctypes.byref(self.callbacks)
        made: int | None = self.c.fmi2Instantiate(
            name, 1, self.guid if guid is None else guid, location, given, 0, 1
        )
        return made

    def started(self, location: bytes | None = None) -> int:
        """An instance that has started."""
        made = self.make(location)
        assert made, self.said
        assert self.c.fmi2SetupExperiment(made, 0, 0.0, 0.0, 0, 0.0) == OK
        assert self.c.fmi2EnterInitializationMode(made) == OK
        assert self.c.fmi2ExitInitializationMode(made) == OK
        return made

    def value(self, instance: int, name: str) -> float:
        """A real variable."""
        found = ctypes.c_double()
        reference = ctypes.c_uint(self.reference[name])
        assert self.c.fmi2GetReal(instance, reference, 1, found) == OK
        return found.value

    def give(self, instance: int, name: str, value: float) -> int:
        """Set a real variable."""
        reference, given = ctypes.c_uint(self.reference[name]), ctypes.c_double(value)
        status: int = self.c.fmi2SetReal(instance, reference, 1, given)
        return status

    def step(self, instance: int, now: float = 0.0, duration: float = 1.0) -> int:
        status: int = self.c.fmi2DoStep(instance, now, duration, 1)
        return status

    def time(self, instance: int) -> float:
        """The time that the instance says it has reached, s."""
        found = ctypes.c_double()
        assert self.c.fmi2GetRealStatus(instance, LAST_SUCCESSFUL_TIME, found) == OK
        return found.value

    def runs(self, location: bytes | None = None) -> None:
        """An instance with this resource location steps and separates."""
        instance = self.started(location)
        assert self.step(instance, 0.0, 30.0) == OK
        assert self.value(instance, "undersize.mass_flow_rate") > 0.0
        self.c.fmi2FreeInstance(instance)
        assert self.said == []

    def refuses(self, *words: str, location: bytes | None = None) -> None:
        """No instance, and one error that says why."""
        assert self.make(location) is None
        ((status, kind, text, _),) = self.said
        assert (status, kind) == (ERROR, "logStatusError")
        for word in words:
            assert word in text
        self.said.clear()


@pytest.fixture(scope="module")
def unzipped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The default screen's FMU, unzipped."""
    folder = tmp_path_factory.mktemp("host")
    path = write_native_fmu(ScreenConfig.default(), folder, [HOST])
    return Path(extract(str(path), unzipdir=str(folder / "screen")))


@pytest.fixture
def host(unzipped: Path) -> Host:
    return Host(unzipped)


@pytest.fixture
def copied(unzipped: Path, tmp_path: Path) -> Callable[..., Path]:
    """Copies of the unzipped FMU in folders of their own."""
    number = count()

    def copy(name: str = "screen") -> Path:
        return shutil.copytree(unzipped, tmp_path / str(next(number)) / name)

    return copy


# --- where it is ---------------------------------------------------------------------------------
def one_slash(folder: Path) -> bytes:
    return folder.as_uri().replace("file:///", "file:/").encode()


def localhost(folder: Path) -> bytes:
    return folder.as_uri().replace("file:///", "file://localhost/").encode()


def all_escaped(folder: Path) -> bytes:
    return b"file://" + b"".join(b"%%%02x" % c if c != 47 else b"/" for c in os.fsencode(folder))


# That of the standard, all that its errata allow, and what tools pass as well.
NAMED = {
    "uri": lambda folder: folder.as_uri().encode(),
    "one slash": one_slash,
    "localhost": localhost,
    "trailing slash": lambda folder: folder.as_uri().encode() + b"//",
    "all escaped": all_escaped,
    "plain path": os.fsencode,
    "large letters": lambda folder: folder.as_uri().replace("file", "FILE").encode(),
}
UNNAMED = {
    "null": None,
    "empty": b"",
    "garbage": b"\xff\xfe%%%zz%4",
    "nowhere": b"file:///no/such/place",
    "web": b"https://example.com/resources",
    "scheme only": b"file:",
    "long": b"file:///" + b"a" * 100_000,
}


@pytest.mark.parametrize("form", [*NAMED, *UNNAMED])
def test_the_library_needs_no_resource_location(host: Host, form: str) -> None:
    """What it reads lies beside it, whatever the host says."""
    named = NAMED[form](host.fmu / "resources") if form in NAMED else UNNAMED[form]
    host.runs(named)


@pytest.mark.parametrize("folder", ODD)
def test_any_folder_will_do(copied: Callable[..., Path], folder: str, tmp_path: Path) -> None:
    """The library in its FMU, and alone with a resource location."""
    fmu = copied(folder)
    Host(fmu).runs(b"")
    alone = tmp_path / folder / "library.so"
    alone.parent.mkdir()
    (found,) = (fmu / "binaries" / HOST).iterdir()
    shutil.copy(found, alone)
    other = Host(fmu, alone)
    other.runs((fmu / "resources").as_uri().encode())
    other.refuses("resources/screen.bin is missing; ")


@pytest.mark.parametrize("form", NAMED)
def test_a_library_that_was_moved_follows_the_host(
    copied: Callable[..., Path], form: str, tmp_path: Path
) -> None:
    fmu = copied("Müll & 100 % [1]" if form != "plain path" else "here")
    (found,) = (fmu / "binaries" / HOST).iterdir()
    moved = Host(fmu, shutil.copy(found, tmp_path / "moved.so"))
    moved.runs(NAMED[form](fmu / "resources"))


@pytest.mark.parametrize("form", UNNAMED)
def test_a_library_that_was_moved_says_where_it_looked(
    unzipped: Path, form: str, tmp_path: Path
) -> None:
    (found,) = (unzipped / "binaries" / HOST).iterdir()
    place = tmp_path / "a" / "b" / "moved.so"
    place.parent.mkdir(parents=True)
    moved = Host(unzipped, shutil.copy(found, place))
    beside = f"{tmp_path}/resources/screen.bin is missing; "
    named = UNNAMED[form]
    moved.refuses(beside if named and len(named) < 1000 else "", location=named)
    if not named:
        moved.refuses("the resource location names no folder: unpack the whole FMU", location=named)


def test_a_link_to_the_library_will_do(unzipped: Path, tmp_path: Path) -> None:
    (found,) = (unzipped / "binaries" / HOST).iterdir()
    link = tmp_path / "linked.so"
    link.symlink_to(found)
    Host(unzipped, link).runs()


def test_a_host_that_loads_by_a_relative_path_and_leaves(
    copied: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fmu = copied()
    (found,) = (fmu / "binaries" / HOST).iterdir()
    monkeypatch.chdir(fmu)
    host = Host(fmu, f"./{found.relative_to(fmu)}")
    host.runs()
    monkeypatch.chdir(tmp_path)
    host.runs((fmu / "resources").as_uri().encode())


# --- what it reads -------------------------------------------------------------------------------
def other_engine(content: bytes) -> bytes:
    mark, engine, size, checksum = HEAD.unpack_from(content)
    return HEAD.pack(mark, engine[::-1], size, checksum) + content[HEAD.size :]


def one_number_more(content: bytes) -> bytes:
    """Whole by its checksum, and not what this library reads."""
    mark, engine, _, _ = HEAD.unpack_from(content)
    body = content[HEAD.size :] + bytes(8)
    return HEAD.pack(mark, engine, len(body), zlib.crc32(body)) + body


def too_many(content: bytes) -> bytes:
    """A count that no file could hold."""
    mark, engine, _, _ = HEAD.unpack_from(content)
    body = struct.pack("<Q", 2**61 + 1) + content[HEAD.size + 8 :]
    return HEAD.pack(mark, engine, len(body), zlib.crc32(body)) + body


BROKEN: dict[str, tuple[Callable[[bytes], bytes | None], str]] = {
    "missing": (lambda content: None, "is missing"),
    "empty": (lambda content: b"", "is cut or changed"),
    "head only": (lambda content: content[: HEAD.size], "is cut or changed"),
    "half a head": (lambda content: content[:20], "is cut or changed"),
    "cut": (lambda content: content[:-1], "is cut or changed"),
    "half": (lambda content: content[: len(content) // 2], "is cut or changed"),
    "longer": (lambda content: content + b"\0", "is cut or changed"),
    "text": (lambda content: b"name = 'screen'\n" * 100, "is cut or changed"),
    "zeros": (lambda content: bytes(len(content)), "is cut or changed"),
    "other engine": (other_engine, "is of another engine than this library"),
    "one more": (one_number_more, "is cut or changed"),
    "too many": (too_many, "is cut or changed"),
}


@pytest.mark.parametrize("how", BROKEN)
def test_a_file_that_is_not_as_it_was_is_told(copied: Callable[..., Path], how: str) -> None:
    """Then what the host names is read, if it is good."""
    fmu, good = copied(), copied()
    change, told = BROKEN[how]
    content = change((fmu / SHEET).read_bytes())
    (fmu / SHEET).unlink()
    if content is not None:
        (fmu / SHEET).write_bytes(content)
    host = Host(fmu)
    host.refuses(f"{fmu / SHEET} {told}; ", "unpack the whole FMU anew")
    location = (fmu / "resources").as_uri().encode()
    host.refuses(f"{fmu / SHEET} {told}; {fmu / SHEET} {told}: unpack", location=location)
    host.runs((good / "resources").as_uri().encode())


def test_no_changed_byte_goes_unseen(copied: Callable[..., Path]) -> None:
    fmu = copied()
    host, content = Host(fmu), (fmu / SHEET).read_bytes()
    places = [*range(0, HEAD.size, 3), *range(HEAD.size, len(content), len(content) // 60)]
    for place in (place for place in places if not 42 <= place < 48):  # unused
        changed = bytes([content[place] ^ (1 << place % 8)])
        (fmu / SHEET).write_bytes(content[:place] + changed + content[place + 1 :])
        host.refuses("screen.bin is ")
    (fmu / SHEET).write_bytes(content)
    host.runs()


def test_a_folder_in_the_place_of_the_file(copied: Callable[..., Path]) -> None:
    fmu = copied()
    (fmu / SHEET).unlink()
    (fmu / SHEET).mkdir()
    Host(fmu).refuses("screen.bin is cut or changed")


def test_the_file_of_another_screen(
    copied: Callable[..., Path], tmp_path: Path, unzipped: Path
) -> None:
    """The same library reads either; the GUID tells which the host means."""
    config = ScreenConfig.load(SCREENS / "two_deck.toml")
    path = write_native_fmu(config, tmp_path / "two", [HOST])
    two = Path(extract(str(path), unzipdir=str(tmp_path / "two_decks")))
    fmu = copied()
    shutil.copy(two / SHEET, fmu / SHEET)
    host = Host(fmu)
    host.refuses(f"{fmu / SHEET} is of another guid")
    host.runs((unzipped / "resources").as_uri().encode())
    host.refuses("is of another guid; ", location=(two / "resources").as_uri().encode())
    both = Host(two)
    both.runs()


# --- how it is called ----------------------------------------------------------------------------
@pytest.mark.parametrize("guid", [b"", b"%s%n%s", b"{00000000-0000-0000-0000-000000000000}"])
def test_another_guid_is_refused(host: Host, guid: bytes) -> None:
    assert host.make(guid=guid) is None
    assert host.text.startswith(f"guid = {guid.decode()} has no resources/screen.bin here: ")


def test_no_name_and_no_callbacks_make_no_instance(host: Host) -> None:
    assert host.c.fmi2Instantiate(b"screen", 1, host.guid, None, None, 0, 1) is None
    assert host.make(name=b"") is None
    assert host.text == "fmi2Instantiate =  makes no instance: give a name and fmi2CoSimulation"
    odd = host.make(name=b"%s%n{name}")
    assert odd
    assert host.step(odd) == ERROR
    host.c.fmi2FreeInstance(odd)


@pytest.mark.parametrize("duration", [0.0, -1.0, math.nan, math.inf, -math.inf, 1e-310, 1e10])
def test_a_step_of_no_length_changes_nothing(host: Host, duration: float) -> None:
    instance, other = host.started(), host.started()
    for one in (instance, other):
        assert host.step(one, 0.0, 5.0) == OK
    assert host.step(instance, 5.0, duration) == ERROR
    assert host.text.startswith("dt = ")
    assert host.time(instance) == 5.0
    names = ("undersize.mass", "oversize.mass", "bed.hold_up", "drive.power")
    for one in (instance, other):
        assert host.step(one, 5.0, 5.0) == OK
    assert [host.value(instance, n) for n in names] == [host.value(other, n) for n in names]
    for one in (instance, other):
        host.c.fmi2FreeInstance(one)


@pytest.mark.parametrize("tolerance", [1e-9, 1e-3, 0.1])
def test_the_tolerance_of_the_experiment_is_taken(host: Host, tolerance: float) -> None:
    instance = host.make()
    assert host.c.fmi2SetupExperiment(instance, 1, tolerance, 0.0, 0, 0.0) == OK
    assert host.value(instance, "solver.tolerance") == tolerance
    assert host.c.fmi2ExitInitializationMode(instance) == OK
    assert host.value(instance, "solver.tolerance") == tolerance
    assert host.c.fmi2SetupExperiment(instance, 1, tolerance, 0.0, 0, 0.0) == ERROR
    assert host.text.startswith("solver.tolerance is a fixed parameter")
    assert host.c.fmi2Reset(instance) == OK
    assert host.value(instance, "solver.tolerance") == 1e-4
    host.c.fmi2FreeInstance(instance)


@pytest.mark.parametrize("tolerance", [5.0, 0.0, -1.0, 1e-10, math.nan, math.inf])
def test_a_tolerance_that_is_none_is_told_and_left(host: Host, tolerance: float) -> None:
    instance = host.make()
    assert host.c.fmi2SetupExperiment(instance, 1, tolerance, 7.0, 0, 0.0) == WARNING
    text = (
        f"tolerance = {tolerance:.6g} is outside of the limits of solver.tolerance, which stays "
        "0.0001: give one within 1e-09 and 0.1"
    )
    assert host.said == [(WARNING, "logStatusWarning", text, text)]
    assert host.value(instance, "solver.tolerance") == 1e-4
    assert host.c.fmi2ExitInitializationMode(instance) == OK
    assert host.time(instance) == 7.0
    host.c.fmi2FreeInstance(instance)


def test_categories_are_switched_by_name(host: Host) -> None:
    """Errors off, warnings on, and the other way round."""
    instance = host.make()
    for kept, other in (("Warning", "Error"), ("Error", "Warning")):
        for on, category in ((0, f"logStatus{other}"), (1, f"logStatus{kept}")):
            names = (ctypes.c_char_p * 1)(category.encode())
            assert host.c.fmi2SetDebugLogging(instance, on, 1, names) == OK
        assert host.c.fmi2SetupExperiment(instance, 1, 5.0, 0.0, 0, 0.0) == WARNING
        assert host.step(instance) == ERROR
        assert {kind for _, kind, *_ in host.said} == {f"logStatus{kept}"}
        host.said.clear()
    host.c.fmi2FreeInstance(instance)


def test_a_state_brings_its_time_back(host: Host) -> None:
    """From memory, and from bytes in another instance."""
    instance, state, size = host.started(), State(), ctypes.c_size_t()
    assert host.step(instance, 0.0, 1.0) == OK
    assert host.c.fmi2GetFMUstate(instance, state) == OK
    assert host.c.fmi2SerializedFMUstateSize(instance, state, size) == OK
    blob = ctypes.create_string_buffer(size.value)
    assert host.c.fmi2SerializeFMUstate(instance, state, blob, size.value) == OK
    assert host.step(instance, 1.0, 20.0) == OK
    mass = host.value(instance, "undersize.mass")
    assert host.time(instance) == 21.0
    assert host.c.fmi2SetFMUstate(instance, state) == OK
    assert host.time(instance) == 1.0
    assert host.c.fmi2FreeFMUstate(instance, state) == OK
    other, again = host.make(), State()
    assert host.time(other) == 0.0
    assert host.c.fmi2DeSerializeFMUstate(other, blob, size.value, again) == OK
    assert host.c.fmi2SetFMUstate(other, again) == OK
    assert host.c.fmi2FreeFMUstate(other, again) == OK
    for one in (instance, other):
        assert host.time(one) == 1.0
        assert host.step(one, 1.0, 20.0) == OK
        assert host.time(one) == 21.0
        assert host.value(one, "undersize.mass") == mass
        host.c.fmi2FreeInstance(one)
