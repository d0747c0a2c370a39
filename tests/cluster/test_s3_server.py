"""The server and its proxies are what tests of a store at a URL take them for."""

import pytest

from curricle.files import place_at

SIZE = 1000


def write_and_read(url, number):
    place = place_at(f"{url}/a folder")
    for k in range(number):
        (place / str(k)).write_bytes(bytes([k]) * SIZE)
    for k in range(number):
        assert (place / str(k)).read_bytes() == bytes([k]) * SIZE
    return len([*place.iterdir()])


def test_every_tenth_request_fails_and_is_asked_again(s3_server, s3_proxy):
    before = len(s3_server.refused())
    assert write_and_read(s3_proxy("--every", "10"), 60) == 60
    refused = s3_server.refused()[before:]
    assert len(refused) >= 2
    assert all(line.startswith("503 ") for line in refused)


def test_a_bucket_that_can_only_be_read(s3, s3_proxy):
    assert write_and_read(s3, 1) == 1
    place = place_at(s3_proxy("--read-only")) / "a folder"
    assert (place / "0").read_bytes() == bytes(SIZE)
    with pytest.raises(PermissionError, match="Access Denied"):
        (place / "b").write_bytes(b"")
