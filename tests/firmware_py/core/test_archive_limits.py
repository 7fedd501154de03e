"""Archives that unpack to too much, or are damaged: FMUs and golden ticks."""

import io
import zipfile

import numpy as np
import pytest

from firmware_py.core import input_files
from firmware_py.core.errors import InputError
from firmware_py.inference.fmu_instance import open_fmu
from firmware_py.inference.golden import Golden, read_golden
from fmu.fmpy_instance import FmuArchive

XML = b'<fmiModelDescription fmiVersion="3.0"><CoSimulation/></fmiModelDescription>'


def archive(path, members, compression=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", compression) as file:
        for name, content in members:
            file.writestr(name, content)
    return path


@pytest.mark.parametrize("read", [open_fmu, FmuArchive], ids=["robot", "FMPy"])
def test_an_fmu_that_is_no_sound_archive_is_refused_before_it_is_unpacked(
    tmp_path, read, monkeypatch
):
    bomb = bytes(input_files.MOST_TEXT_BYTES + 1)  # 4 kB as a file
    path = archive(tmp_path / "a.fmu", [("modelDescription.xml", bomb)])
    with pytest.raises(InputError, match="holds an XML file of more than 4 MB"):
        read(path)
    monkeypatch.setattr(input_files, "MOST_UNPACKED_BYTES", 1000)
    path = archive(tmp_path / "a.fmu", [("modelDescription.xml", XML), ("a.so", bytes(1001))])
    with pytest.raises(InputError, match="unpacks to more than"):
        read(path)
    many = [(str(k), b"") for k in range(input_files.MOST_MEMBERS + 1)]
    with pytest.raises(InputError, match="has 1001 members"):
        read(archive(tmp_path / "a.fmu", many))
    with pytest.raises(InputError, match=r"path outside the archive \(\.\./a\)"):
        read(archive(tmp_path / "a.fmu", [("../a", b"")]))
    with pytest.warns(match="Duplicate name"):
        path = archive(tmp_path / "a.fmu", [("modelDescription.xml", XML)] * 2)
    with pytest.raises(InputError, match="two files of one name"):
        open_fmu(path)


@pytest.mark.parametrize(
    "header",
    ["(1000000000000, 1)", "(" * 200, "(-1,)", "(100, 1), 'x': " + "[" * 3000],
    ids=["huge", "open", "negative", "deep"],
)
def test_a_huge_or_damaged_header_of_an_array_is_refused(tmp_path, header):
    assert_no_golden_ticks(tmp_path, npy(header))


def npy(header):
    """An array file whose header has a shape that NumPy would not write."""
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {header}, }}".encode()
    text += b" " * (-(10 + len(text) + 1) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


def assert_no_golden_ticks(directory, array):
    path = archive(directory / "golden.npz", [(f"{n}.npy", array) for n in Golden._fields])
    with pytest.raises(InputError, match="golden"):
        read_golden(path, 1)


def test_a_pickled_array_is_refused(tmp_path):
    stream = io.BytesIO()
    np.save(stream, np.array([{}], dtype=object), allow_pickle=True)
    assert_no_golden_ticks(tmp_path, stream.getvalue())
