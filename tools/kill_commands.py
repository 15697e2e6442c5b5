"""Kill the commands that write, at commits and at random moments, and compare what they leave.

In every folder a command is killed twice: at a commit, just before it or just after, and then,
resumed, at any moment. Resumed once more it ends in peace, and its folder must be what a run that
nobody killed has made, bit for bit. Exit code 1 where one differs.
"""

import json
import random
import shutil
import sys
import tempfile
from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path

# The repository comes before tools/, where study.py would hide the package of its name.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from study.cli import guarded_imports, run_command

with guarded_imports():
    from study.options import LARGEST_SEED, Options
    from taichi_nmm.errors import InputError
    from tools.killing.digest import digest
    from tools.killing.process import Death, Ended, run
    from tools.killing.scenes import Scene, load, preparations, scenes, write_configs

MOST_KILLS = 100_000
LOG_NAME, DIGEST_NAME = "log.txt", "digest.json"


class Theatre:
    """A folder in which scenes are played.

    Args:
        folder: empty.
        pictures: whether walks are drawn, as of `scenes`.
    """

    def __init__(self, folder: Path, pictures: bool = True) -> None:
        """Make what all scenes need."""
        self._folder, self._base = folder, folder / "base"
        self.scenes = scenes(pictures)
        write_configs(self._base)
        load(pictures)
        for scene in preparations(pictures):
            self._in_peace(scene, self._base)

    def whole(self, scene: Scene) -> tuple[Ended, dict[str, str]]:
        """A run that nobody kills, and the digest of its folder."""
        folder = self._stage(scene)
        return self._in_peace(scene, folder), self._digest(folder)

    def killed(self, scene: Scene, deaths: Iterator[Death]) -> tuple[list[Ended], dict[str, str]]:
        """Runs in one folder, each killed, and one in peace; the digest of the folder."""
        folder = self._stage(scene)
        ended = [self._play(scene, folder, death) for death in deaths]
        self._in_peace(scene, folder)
        return ended, self._digest(folder)

    def _stage(self, scene: Scene) -> Path:
        folder = self._folder / "stage"
        shutil.rmtree(folder, ignore_errors=True)
        scene.prepare(self._base, folder)
        return folder

    def _play(self, scene: Scene, folder: Path, death: Death) -> Ended:
        log = self._folder / LOG_NAME
        log.write_text("")
        ended = run(lambda: scene.run(self._base), folder, log, death)
        if ended.code and not ended.killed:
            raise RuntimeError(f"{scene.command} ended with {ended.code}: {log.read_text()}")
        return ended

    def _in_peace(self, scene: Scene, folder: Path) -> Ended:
        return self._play(scene, folder, Death())

    def _digest(self, folder: Path) -> dict[str, str]:
        file = self._folder / DIGEST_NAME
        log = self._folder / LOG_NAME
        run(lambda: void(file.write_text(json.dumps(digest(folder)))), self._folder, log)
        found: dict[str, str] = json.loads(file.read_text())
        file.unlink()
        return found


def void(_: object) -> None:
    """Nothing."""


@dataclass
class Tally:
    """What became of a command's kills."""

    kills: int = 0
    at_commit: int = 0
    folders: int = 0
    different: list[str] = field(default_factory=list)

    def row(self, command: str) -> str:
        """A row of the table."""
        equal = self.folders - len(self.different)
        counts = (self.kills, self.at_commit, self.folders, equal)
        return f"| {command} | {' | '.join(map(str, counts))} |"


def commit_death(whole: Ended, dice: random.Random) -> Death:
    """At one of a command's commits: any name, any of its times, before it or after."""
    name = dice.choice(sorted(set(whole.commits)))
    number = dice.randint(1, whole.commits.count(name))
    return Death(name, number, after=dice.random() < 0.5)


def kill(theatre: Theatre, commands: Sequence[str], kills: int, seed: int) -> dict[str, Tally]:
    """Kill in turn, so often in total; a command that ended before its death was not killed."""
    dice = random.Random(seed)
    wholes = {command: theatre.whole(theatre.scenes[command]) for command in commands}
    tallies = {command: Tally() for command in commands}
    for command in cycle(commands):
        if sum(tally.kills for tally in tallies.values()) >= kills:
            return tallies
        (whole, expected), tally = wholes[command], tallies[command]
        deaths = [commit_death(whole, dice), Death(delay_s=dice.uniform(0.0, whole.wall_s))]
        ended, found = theatre.killed(theatre.scenes[command], iter(deaths))
        tally.folders += 1
        tally.kills += sum(each.killed for each in ended)
        tally.at_commit += ended[0].killed
        names = sorted({name for name, _ in expected.items() ^ found.items()})
        if names:
            tally.different.append(f"{command}, {deaths}: {', '.join(names)}")
        print(f"{command}: {'different' if names else 'equal'}, {deaths}", file=sys.stderr)


def parse() -> Namespace:
    parser = Options(__file__)
    parser.whole("--kills", 1, MOST_KILLS, default=100, help="in total (%(default)s)")
    parser.whole("--seed", 0, LARGEST_SEED, default=1, help="of the moments (%(default)s)")
    parser.add_argument("--commands", metavar="A,B,C", help="default: all that write")
    return parser.parse_args()


def main(pictures: bool = True) -> None:
    args = parse()
    known = list(scenes(pictures))
    commands = known if args.commands is None else args.commands.split(",")
    for command in commands:
        if command not in known:
            raise InputError("commands", command, f"of {', '.join(known)}")
    folder = Path(tempfile.mkdtemp())  # TemporaryDirectory's would go with the first process
    try:
        tallies = kill(Theatre(folder, pictures), commands, args.kills, args.seed)
    finally:
        shutil.rmtree(folder)
    print("| command | kills | at a commit | folders | bit-equal |\n|---|--:|--:|--:|--:|")
    for command, tally in tallies.items():
        print(tally.row(command))
    different = [line for tally in tallies.values() for line in tally.different]
    print(*different, sep="\n", file=sys.stderr)
    if different:
        sys.exit(1)


if __name__ == "__main__":
    run_command(main)
