"""`spheremcap dataset` as a person gives it: init, list, run, list, tables."""

import pytest
from seasons import dataset, write_session


@pytest.fixture(scope="module")
def season(tmp_path_factory):
    folder = tmp_path_factory.mktemp("season")
    write_session(folder / "videos" / "anna")
    write_session(folder / "videos" / "bo", seeds=False)
    return folder


def test_from_videos_to_tables(season):
    found = dataset("init", "videos", "-o", "season.toml", cwd=season)
    assert found.returncode == 0, found.stderr
    assert "anna_v: v.mp4" in found.stdout
    assert "    seeds: spheremcap annotate videos/bo/v.mp4" in found.stdout
    assert "2 sessions -> season.toml" in found.stdout
    again = dataset("init", "videos", "-o", "season.toml", cwd=season)
    assert again.returncode == 2
    assert "exists already" in again.stderr
    manifest = season / "season.toml"
    before = manifest.read_bytes()
    added = dataset("init", "videos", "-o", "season.toml", "--add", cwd=season)
    assert added.stdout == "0 new sessions -> season.toml (2 there already)\n"
    assert manifest.read_bytes() == before
    manifest.chmod(0o600)
    text = before.decode()
    manifest.write_text(text[: text.index("[[sessions]]", text.index('name = "anna_v"'))])
    added = dataset("init", "videos", "-o", "season.toml", "--add", cwd=season)
    assert "bo_v: v.mp4" in added.stdout
    assert "1 new session -> season.toml (1 there already)" in added.stdout
    assert manifest.stat().st_mode & 0o777 == 0o600
    for place in ("videos/anna/v.mp4", "videos/anna/settings.toml"):
        over = dataset("init", "videos", "-o", place, "--overwrite", cwd=season)
        assert over.returncode == 2
        assert "input" in over.stderr
    away = dataset("init", season / "videos", "-o", season / "season.toml", "--add", cwd=season / "videos")
    assert f"paths are told as from {season}" in away.stderr
    assert "anna_v: not run (v.mp4)" in dataset("list", "season.toml", cwd=season).stdout

    done = dataset("run", "season.toml", "-o", "out", cwd=season)
    assert done.returncode == 3, done.stderr
    assert "bo_v: failed: no seeds" in done.stdout
    assert "1 done, 0 with losses, 1 failed, 0 not run -> out" in done.stdout
    listed = dataset("list", "season.toml", "-o", "out", cwd=season).stdout
    assert "anna_v: done, 100.0% measured (v.mp4)" in listed
    assert "bo_v: failed: no seeds" in listed
    manifest.write_text(before.decode().replace('name = "bo_v"', 'name = "bo"'))
    listed = dataset("list", "season.toml", "-o", "out", cwd=season)
    assert "bo: not run (v.mp4)" in listed.stdout
    assert listed.stderr == "spheremcap: of no session of the manifest: out/bo_v\n"
    manifest.write_bytes(before)
    settings = season / "videos" / "anna" / "settings.toml"
    settings.write_text(settings.read_text().replace('"none"', '"full"'))
    assert "anna_v: changed since it was run" in dataset("list", "season.toml", "-o", "out", cwd=season).stdout

    assert dataset("tables", "out", "-o", "tables", cwd=season).returncode == 0
    assert (season / "tables" / "poses" / "session=anna_v" / "poses.parquet").is_file()
    assert dataset("tables", "out", "-o", "tables", cwd=season).returncode == 2
    assert dataset("requests", "out", cwd=season).stdout == "0 open in 0 sessions\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("run", "no.toml", "-o", "out"), "no such file"),
        (("run", "season.toml", "-o", "videos"), "no season was run into it"),
        (("run", "season.toml", "-o", "out2", "--dask", "tcp://127.0.0.1:9", "--workers", "2"), "--workers"),
        (("run", "season.toml", "-o", "out2", "--shard", "7"), "--shard"),
        (("tables", "videos", "-o", "x"), "no season was run into it"),
        (("requests", "videos"), "no season was run into it"),
    ],
)
def test_what_cannot_be_is_one_line(season, arguments, said):
    if not (season / "season.toml").exists():
        dataset("init", "videos", "-o", "season.toml", cwd=season)
    done = dataset(*arguments, cwd=season)
    assert done.returncode in (1, 2)
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
