"""Commands in processes that a shell or a machine is unkind to: one line, or nothing amiss."""

import json
import os
import shutil
import signal
import subprocess
from contextlib import contextmanager
from pathlib import Path

import optuna
import pytest
from optuna.trial import TrialState

from tests.study import fake_walker
from tests.tools.running import ROOT, WAIT_S, Done, finish, start

pytestmark = pytest.mark.slow

STUDY = "study --config toy.toml --arm dog --storage sqlite:///studies.db --out out --trials 4"
COMPARE = "compare --config toy.toml --arms random,dog --runs 1 --trials 2 --workers 1 --out out"
LIST = "walk --list-configs"
FULL = "error: machine: 'No space left on device' cannot be used; allowed: space for files and for "
REDIRECTED = 'exec "$@" {}'
# Runs commands, a line each, one after another; prints how each of them ended.
EACH = """
import io, json, sys
from contextlib import redirect_stderr, redirect_stdout
from tests.tools.fake_command import main
ended = []
for line in sys.argv[1:]:
    with redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as error:
        try:
            main(line.split())
        except SystemExit as end:
            ended.append((end.code, out.getvalue(), error.getvalue()))
print(json.dumps(ended))
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A configuration and its store."""
    folder = tmp_path_factory.mktemp("made")
    fake_walker.write_config(folder)
    return folder


@pytest.fixture
def folder(made, tmp_path, monkeypatch):
    """A folder for one command, with the configuration; the commands run in it."""
    shutil.copy(made / "toy.toml", tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(command, shell="", **options):
    """Run a command; `shell` are redirections, or a limit."""
    return finish(start(*command.split(), shell=shell, **options))


def trials(folder):
    """Parameters of the finished trials of the one study."""
    url = f"sqlite:///{folder / 'studies.db'}"
    study = optuna.load_study(study_name="toy/dog/run-000", storage=url)
    return [trial.params for trial in study.get_trials(states=(TrialState.COMPLETE,))]


@pytest.fixture(scope="module")
def undisturbed(made):
    """The trials of a study that nobody is unkind to."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(made)
        assert run(STUDY).code == 0
    assert len(trials(made)) == 4
    return trials(made)


@pytest.mark.parametrize("closed", ["<&- >&-", "<&- >&- 2>&-"])
def test_closed_files_are_like_null_devices(folder, closed, undisturbed):
    """What is printed does not get into the database, whose number would be that of stdout."""
    done = run(STUDY, REDIRECTED.format(closed))
    assert done.code == 0 and "Traceback" not in done.error
    assert trials(folder) == undisturbed
    json.loads((folder / "out" / "dog-run-000-best.json").read_text())


def test_a_full_disk_for_output_is_one_line_and_no_loss(folder, undisturbed):
    done = run(LIST, REDIRECTED.format(">/dev/full"))
    assert done.code == 2 and len(done.lines) == 1 and done.last.startswith(FULL)
    done = run(STUDY, REDIRECTED.format(">/dev/full"))
    assert done.code == 2 and done.last.startswith(FULL)
    assert trials(folder) == undisturbed
    # Where nothing can be said, the exit code says it.
    done = run("walk --gains nowhere.json", REDIRECTED.format("2>/dev/full"))
    assert done == Done(2, "", "")


def test_a_reader_that_has_enough_ends_the_command_without_a_word(folder):
    """As `2>&1 | head -1`, of standard output and standard error."""
    for command in (STUDY, LIST):
        done = run(command, '"$@" 2>&1 | true; exit ${PIPESTATUS[0]}')
        assert done == Done(141, "", "")
    assert run(STUDY).code == 0


def test_little_memory_is_one_line_before_anything_is_written(folder):
    tool = ROOT / "tools" / "study.py"
    words = STUDY.removeprefix("study ")
    done = run(words, 'ulimit -v 400000; exec "$@"', program=[tool])
    line = "error: ulimit -v: 400000 cannot be used; allowed: 4194304 or more, or unlimited\n"
    assert done == Done(2, "", line)
    assert [path.name for path in folder.iterdir()] == ["toy.toml"]


@pytest.mark.campaign
@pytest.mark.parametrize("command", [STUDY, COMPARE])
def test_files_that_may_not_grow_are_one_line_and_it_resumes(folder, command):
    done = run(command, 'ulimit -f 8; exec "$@"')
    assert done.code == 2 and "Traceback" not in done.error
    assert done.last.startswith("error: ")
    assert not list(folder.rglob("*.tmp*")) and not list(folder.rglob("*.parquet"))
    assert run(command).code == 0


def without_the_rights_of_root():
    """The line of a shell that makes a process obey the modes of files, whoever runs the tests."""
    if os.getuid() != 0:
        return 'exec "$@"'
    if shutil.which("setpriv") is None:
        pytest.skip("root may write everywhere, and there is no setpriv to change that")
    return 'exec setpriv --bounding-set=-dac_override,-dac_read_search "$@"'


def assert_refused(*commands):
    """Without root's rights each is refused in one line, and these are the lines."""
    shell = without_the_rights_of_root()
    done = finish(start(*commands, shell=shell, program=("-c", EACH)))
    ended = json.loads(done.out)
    assert [(code, out) for code, out, _ in ended] == [(2, "")] * len(commands)
    lines = [error for _, _, error in ended]
    assert [line.count("\n") for line in lines] == [1] * len(commands), lines
    return lines


def test_a_read_only_folder_is_one_line_and_nothing_is_left(folder):
    folder.chmod(0o555)
    try:
        lines = assert_refused(STUDY, COMPARE, "walk --out out")
    finally:
        folder.chmod(0o755)
    assert all(line.startswith(("error: out: ", "error: storage: ")) for line in lines)
    assert [path.name for path in folder.iterdir()] == ["toy.toml"]


def test_a_folder_of_somebody_else_is_one_line(made, folder):
    store = Path(shutil.copytree(made / "store", folder / "store"))
    store.chmod(0o000)
    try:
        assert_refused(
            "explore store --no-browser --port 0",
            "report store",
            "walk --store store --row 0",
            "walk --gains store/manifest.json",
            "precompute --config store/toy.toml",
            COMPARE.replace("--out out", "--out store/out"),
        )
    finally:
        store.chmod(0o755)


@contextmanager
def stopped(command):
    """A command that is stopped in its second simulation; after the block it goes on to its end."""
    with start(*command.split(), signal="2:SIGSTOP") as process:
        assert os.WIFSTOPPED(os.waitpid(process.pid, os.WUNTRACED)[1])
        try:
            yield
        finally:
            process.send_signal(signal.SIGCONT)
            process.communicate(timeout=WAIT_S)
    assert process.returncode == 0


def test_a_stopped_process_keeps_its_study_and_goes_on(folder, undisturbed):
    with stopped(STUDY):
        second = run(STUDY)
    assert second.code == 2 and len(second.lines) == 1
    assert second.error.startswith("error: study: 'toy/dog/run-000'")
    assert trials(folder) == undisturbed


def test_a_umask_is_obeyed_and_few_open_files_are_enough(folder, undisturbed):
    assert run(STUDY, 'umask 077; ulimit -n 16; exec "$@"').code == 0
    assert trials(folder) == undisturbed
    made = [path for path in folder.rglob("*") if path.name != "toy.toml"]
    assert made and not any(path.stat().st_mode & 0o077 for path in made)


def test_a_folder_being_filled_and_its_copy(folder, monkeypatch):
    with stopped(COMPARE):
        shutil.copytree(folder, folder / "copy")
        second = run(COMPARE)
    assert second.code == 2
    assert "a folder that no other process is filling" in second.error
    monkeypatch.chdir(folder / "copy")
    assert run(COMPARE).code == 0
    first, copied = (place / "out" / "trials.parquet" for place in (folder, Path()))
    assert first.read_bytes() == copied.read_bytes()


@pytest.mark.campaign
def test_no_time_left_is_the_shells_signal_and_resumes(folder, undisturbed):
    """A second is gone with the imports, or soon after them."""
    assert run(STUDY, 'ulimit -t 1; exec "$@"').code in (
        -signal.SIGXCPU,
        -signal.SIGKILL,
    )
    assert run(STUDY).code == 0
    assert trials(folder) == undisturbed


def test_a_clock_that_was_set_back_changes_no_trial(folder, undisturbed):
    if shutil.which("faketime") is None:
        pytest.skip("no faketime here: apt-get install faketime")
    assert run(STUDY.replace("--trials 4", "--trials 2")).code == 0
    assert run(STUDY, 'exec faketime -f -400d "$@"').code == 0
    assert trials(folder) == undisturbed


READ_ONLY = 'mount -t tmpfs -o ro none /dev/shm && exec "$@"'


@pytest.mark.parametrize(
    ("work", "code", "line"),
    [
        ("--workers 2", 0, ""),
        (
            "--cluster local:1",
            2,
            "error: cluster: 'local:1' cannot be used; allowed: a machine "
            "with shared memory (/dev/shm) that can be written",
        ),
    ],
)
def test_without_shared_memory(folder, work, code, line):
    """As in some containers. Our own processes need none; those of Dask do."""
    tried = subprocess.run(["unshare", "--mount", "true"], capture_output=True)
    if tried.returncode != 0:
        pytest.skip("mounting needs root's rights")
    command = COMPARE.replace("--workers 1", work)
    done = run(command, f"exec unshare --mount bash -c '{READ_ONLY}' bash \"$@\"")
    assert "Traceback" not in done.error
    assert done.code == code and done.last.startswith(line)
