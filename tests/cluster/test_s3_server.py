"""The server and its proxies are what tests of a store at a URL take them for."""

import pytest
from pyarrow import fs

SIZE = 1000  # of an answer smaller than S3's error, pyarrow does not ask again


def write_and_read(url, number):
    opened, bucket = fs.FileSystem.from_uri(f"{url}?allow_delayed_open=true")
    for k in range(number):
        with opened.open_output_stream(f"{bucket}/a folder/{k}") as file:
            file.write(bytes([k]) * SIZE)
    for k in range(number):
        assert opened.open_input_file(f"{bucket}/a folder/{k}").read() == bytes([k]) * SIZE
    return len(opened.get_file_info(fs.FileSelector(bucket, recursive=True)))


def test_every_fiftieth_request_fails_and_is_asked_again(s3_server, s3_proxy):
    before = len(s3_server.refused())
    assert write_and_read(s3_proxy("--every", "50"), 60) == 61  # and the folder
    refused = s3_server.refused()[before:]
    assert len(refused) >= 2
    assert all(line.startswith("503 ") for line in refused)


def test_a_bucket_that_can_only_be_read(s3, s3_proxy):
    assert write_and_read(s3, 1) == 2
    url = s3_proxy("--read-only")
    opened, bucket = fs.FileSystem.from_uri(url)
    assert opened.open_input_file(f"{bucket}/a folder/0").read() == bytes(SIZE)
    with pytest.raises(OSError, match="ACCESS_DENIED"), opened.open_output_stream(f"{bucket}/b"):
        pass
