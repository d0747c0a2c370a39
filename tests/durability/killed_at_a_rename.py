"""Run a command once for each file that it moves into place, killed just before it is moved.

Usage: python killed_at_a_rename.py COMMAND STUDY.toml FOLDER [FIRST]. Each killed run is then
resumed to its end in FOLDER/0, FOLDER/1, ... (from FIRST on, which may be negative); FOLDER/whole
is the command in one go. Prints how many files are moved.
"""

import os
import signal
import sys
from pathlib import Path

from curricle.show.report import write_audit, write_report
from curricle.study import audit, read_study, run_study


def run(study, folder):
    run_study(study, folder, resume=True, workers=1, progress=False)


def report(study, folder):
    run(study, folder)
    write_report(folder)


def audited(study, folder):
    made = audit(study, folder, trials=1, workers=1, progress=False)
    write_audit(made, folder / "audit.html")


COMMANDS = {"run": run, "report": report, "audit": audited}
move = os.replace


def in_a_process(command, study, folder, kill=None):
    """Return how many files a run moved; it is killed before it moves the file of number `kill`."""
    count = folder.with_suffix(".moves")
    child = os.fork()
    if child == 0:
        moved = 0

        def counted(source, target):
            nonlocal moved
            if Path(target).is_relative_to(folder):  # compiled code is moved too
                if moved == kill:
                    os.kill(os.getpid(), signal.SIGKILL)
                moved += 1
            move(source, target)

        os.replace = counted
        code = 1
        try:
            command(study, folder)
            count.write_text(str(moved))
            code = 0
        finally:
            os._exit(code)
    _, status = os.waitpid(child, 0)
    killed = os.WIFSIGNALED(status)
    assert killed is (kill is not None)
    assert killed or os.WEXITSTATUS(status) == 0, f"a run failed in {folder}"
    return None if killed else int(count.read_text())


def main():
    name, file, folder, *rest = sys.argv[1:]
    command, study, folder = COMMANDS[name], read_study(file), Path(folder)
    moves = in_a_process(command, study, folder / "whole")
    print(moves)
    for kill in range(moves)[int(rest[0]) if rest else 0 :]:
        in_a_process(command, study, folder / str(kill), kill)
        in_a_process(command, study, folder / str(kill))


if __name__ == "__main__":
    main()
