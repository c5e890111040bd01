"""RDT as public clients show it; the bytes were written by hand."""

import pytest

from drivers.core.errors import CodecError
from drivers.udp_force.codec import (
    BoxSettings,
    ForceRecord,
    decode_records,
    decode_request,
    decode_settings,
    encode_record,
    encode_request,
    faults_of,
)

RECORD = bytes.fromhex(
    "00000102"  # record 258
    "fffffff9"  # sample 2**32 - 7
    "80010000"  # a threshold of the box's own was passed
    "000f4240 fff0bdc0 00000000"  # 1,000,000, -1,000,000, 0
    "00000001 ffffffff 7fffffff"
)

PAGE = """<?xml version="1.0"?><netft><prodname>Net F/T</prodname>
<scfgfu>{force}</scfgfu><scfgtu>{torque}</scfgtu><cfgcpf>1000</cfgcpf><cfgcpt> 500 </cfgcpt>
<comrdtrate>1000</comrdtrate><runrate>7000</runrate></netft>"""


@pytest.mark.parametrize(
    ("command", "records", "data"),
    [
        ("start", 0, "1234 0002 00000000"),
        ("start", 1, "1234 0002 00000001"),
        ("stop", 0, "1234 0000 00000000"),
        ("bias", 0, "1234 0042 00000000"),
    ],
)
def test_golden_requests(command: str, records: int, data: str) -> None:
    assert encode_request(command, records) == bytes.fromhex(data)
    assert decode_request(bytes.fromhex(data)) == (command, records)


def test_golden_record() -> None:
    record = ForceRecord(258, 2**32 - 7, 0x80010000, (1_000_000, -1_000_000, 0, 1, -1, 2**31 - 1))
    assert list(decode_records(RECORD)) == [record]
    assert list(decode_records(RECORD * 3)) == [record] * 3
    assert encode_record(record) == RECORD


@pytest.mark.parametrize("data", [b"", RECORD[:-1], RECORD + b"\0", b"hello"])
def test_what_is_no_record_is_an_error(data: bytes) -> None:
    with pytest.raises(CodecError):
        list(decode_records(data))


@pytest.mark.parametrize("data", ["", "1234 0002", "4321 0002 00000000", "1234 0099 00000000"])
def test_what_is_no_request_is_an_error(data: str) -> None:
    with pytest.raises(CodecError):
        decode_request(bytes.fromhex(data))


@pytest.mark.parametrize(
    ("make", "status", "said"),
    [
        ("net_ft", 0, ""),
        ("net_ft", 0x80010000, ""),
        ("net_ft", 0x80020000, ""),
        ("net_ft", 0x90000000, "analog board"),
        ("net_ft", 0x82000000, "halted by its configuration"),
        ("net_ft", 0x80000004, "see the table"),
        ("axia", 0x00000008, ""),
        ("axia", 0xC0000000, ""),
        ("axia", 0x88000000, ""),
        ("axia", 0xA0000000, "checksum of the calibration"),
        ("axia", 0x80000004, "broken gage"),
        ("axia", 0x80020000, "see the table"),
    ],
)
def test_the_status_word_says_what_is_wrong_with_the_box(make: str, status: int, said: str) -> None:
    found = faults_of(status, make)
    assert (found == "") == (said == "")
    assert said in found


@pytest.mark.parametrize(
    ("force", "torque", "per_n", "per_nm"),
    [
        ("N", "Nm", 1000.0, 500.0),
        ("kN", "N-mm", 1.0, 500_000.0),
        # one pound-force is 4.4482216 N; one pound-force inch 0.11298483 N m
        ("lbf", "lbf-in", 224.80894, 4425.3728),
    ],
)
def test_counts_are_of_newtons_whatever_unit_the_box_has(
    force: str, torque: str, per_n: float, per_nm: float
) -> None:
    found = decode_settings(PAGE.format(force=force, torque=torque))
    assert found == pytest.approx(BoxSettings(per_n, per_nm, 1000.0, 7000.0), rel=1e-6)


@pytest.mark.parametrize(
    "page",
    [
        "",
        "<html>login</html>",
        PAGE.format(force="stone", torque="Nm"),
        PAGE.format(force="N", torque="Nm").replace(">1000<", ">0<"),
        PAGE.format(force="N", torque="Nm").replace("7000", "x"),
    ],
)
def test_a_page_without_them_is_an_error(page: str) -> None:
    with pytest.raises(CodecError):
        decode_settings(page)
