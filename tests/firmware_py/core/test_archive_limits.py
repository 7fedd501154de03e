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
def test_an_fmu_that_unpacks_to_too_much_is_refused_before_it_is(tmp_path, read, monkeypatch):
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


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_two_files_of_one_name_are_refused(tmp_path):
    path = archive(tmp_path / "a.fmu", [("modelDescription.xml", XML)] * 2)
    with pytest.raises(InputError, match="two files of one name"):
        open_fmu(path)


def test_damaged_lzma_is_refused(tmp_path):
    path = archive(tmp_path / "a.fmu", [("modelDescription.xml", XML * 9)], zipfile.ZIP_LZMA)
    data = bytearray(path.read_bytes())
    at = data.index(b"modelDescription.xml") + 40
    data[at : at + 20] = bytes(range(200, 220))
    path.write_bytes(data)
    with pytest.raises(InputError, match="is no FMU"):
        open_fmu(path)


@pytest.mark.parametrize(
    "header",
    ["(1000000000000, 1)", "(" * 200, "(-1,)", "(100, 1), 'x': " + "[" * 3000],
    ids=["huge", "open", "negative", "deep"],
)
def test_a_huge_or_damaged_header_of_an_array_is_refused(tmp_path, header):
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {header}, }}".encode()
    text += b" " * (-(10 + len(text) + 1) % 64) + b"\n"
    array = b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text
    path = archive(tmp_path / "golden.npz", [(f"{n}.npy", array) for n in Golden._fields])
    with pytest.raises(InputError, match="golden"):
        read_golden(path, 1)


def test_a_pickled_array_is_refused(tmp_path):
    stream = io.BytesIO()
    np.save(stream, np.array([{}], dtype=object), allow_pickle=True)
    members = [(f"{n}.npy", stream.getvalue()) for n in Golden._fields]
    path = archive(tmp_path / "golden.npz", members)
    with pytest.raises(InputError, match="golden"):
        read_golden(path, 1)
