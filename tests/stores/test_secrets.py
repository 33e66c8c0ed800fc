"""What is given to stores is shown nowhere: not in outputs, manifests, messages or configs."""

from pathlib import Path

import pytest
from shapefit.cli.main import run as shapefit

from shapefit.config import load_config
from shapefit.stores import masked, use_storage_options

KEY, SECRET, TOKEN = "planted-key", "planted-secret", "planted-token"
PLANTED = b"planted-"


@pytest.fixture
def config(bucket, project, tmp_path, monkeypatch, store_address) -> Path:
    """A config of `fit` with secrets; another one is in the environment."""
    bucket.files.put_file(
        str(project / "sample_data" / "people_views.csv"), f"{bucket.name}/views.csv"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    monkeypatch.setenv("AWS_SESSION_TOKEN", TOKEN)
    path = tmp_path / "fit.yaml"
    path.write_text(
        f"landmarks: {bucket.url}/views.csv\n"
        "dictionary: people\n"
        f"output: {bucket.url}/results/\n"
        "storage_options:\n"
        f"  key: {KEY}\n"
        f"  secret: {SECRET}\n"
        f"  endpoint_url: {store_address}\n"
    )
    return path


def written(bucket, folder: Path) -> dict[str, bytes]:
    """Return what is in the bucket and in the working folder, the config aside."""
    found = {name: bucket.files.cat_file(name) for name in bucket.files.find(bucket.name)}
    paths = (path for path in folder.rglob("*") if path.is_file() and path.name != "fit.yaml")
    return found | {str(path): path.read_bytes() for path in paths}


def test_of_a_fit(bucket, config, tmp_path, capfd):
    lines = [
        ("fit", "-c", config, "-v"),
        ("fit", "-c", config, "-v", "-o", "local.h5"),
        ("fit", "-c", config, "-v", "-o", f"{bucket.url}/one.h5"),
        ("fit", "-c", config, "--print-config"),
        ("fit", "-c", config, "--dry-run", "--set", "lambda=0.2"),
    ]
    for line in lines:
        assert shapefit([str(word) for word in line]) == 0, line
    printed = capfd.readouterr()
    assert "secret: '***'" in printed.out
    assert PLANTED.decode() not in printed.out + printed.err
    found = written(bucket, tmp_path)
    assert f"{bucket.name}/results/manifest.jsonl" in found
    assert f"{bucket.name}/results/part-00000.h5" in found
    assert str(tmp_path / "local.h5") in found
    assert [name for name, content in found.items() if PLANTED in content] == []


@pytest.mark.parametrize(
    "changes",
    [
        ["landmarks=s3://no-such-bucket/a.h5"],
        ["storage_options.endpoint_url=http://planted-host.invalid:9"],
        ["storage_options.planted-key=1", "storage_options.secret=[planted-list]"],
        ["storage_options=planted-text"],
        ["storage_options.secret={planted-"],
        ["lambda=-1"],
    ],
    ids=["bucket", "host", "options", "no-mapping", "no-yaml", "other-key"],
)
def test_of_errors(bucket, config, capfd, impatient, changes):
    words = [word for change in changes for word in ("--set", change)]
    assert shapefit(["fit", "-c", str(config), *words]) == 2
    printed = capfd.readouterr()
    assert printed.err
    for name in (KEY, SECRET, TOKEN, "planted-host", "planted-list", "planted-text", "{planted-"):
        if name != "planted-key" or "options" not in changes[0]:
            assert name not in printed.out + printed.err


def test_of_what_dask_logs(config):
    job = load_config("fit", config)
    assert job.storage_options["secret"] == SECRET
    assert PLANTED.decode() not in repr(job)


def test_the_options_are_no_part_of_the_terms(bucket, config, capfd):
    assert shapefit(["fit", "-c", str(config)]) == 0
    other = ("--set", "storage_options.default_block_size=5242880")
    assert shapefit(["fit", "-c", str(config), *other]) == 0
    assert "fit: 0 images" in capfd.readouterr().err


def test_a_secret_that_begins_another_one_shows_nothing_of_it(monkeypatch):
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", f"{SECRET}-of-more")
    use_storage_options({"key": KEY, "client_kwargs": {"secret": [SECRET]}})
    try:
        assert masked(f"{KEY}, {SECRET}, {SECRET}-of-more") == "***, ***, ***"
    finally:
        use_storage_options({})
