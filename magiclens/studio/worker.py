"""The worker: runs one job at a time, each run a process of its own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO

from magiclens.cache.folder import FOLDER_VARIABLE
from magiclens.studio.orders import SPEC
from magiclens.studio.store import StudioFolder

_MLENS = (sys.executable, "-P", "-m", "magiclens")
"""The command line; with ``-P`` nothing in a job's folder is taken for a module."""
PATIENCE_S = 10.0
"""How long a process that was asked to end may take."""
_MOST_WORDS = 2000
"""Letters of a message that are kept."""


class Worker:
    """A thread that runs what waits, in the order of the jobs, and notes in their folders how it went.

    What ran when the studio ended waits again: its results so far are in the cache, and the run goes on from there.
    """

    def __init__(self, store: StudioFolder, program: Sequence[str] = _MLENS):
        self._store, self._program = store, program
        self._wake = threading.Condition(store.lock)
        self._thread = threading.Thread(target=self._work, name="studio-worker", daemon=True)
        self._child: subprocess.Popen[str] | None = None
        self._running: str | None = None
        self._cancelled = self._ending = False

    def start(self) -> None:
        """Begin; what was running when the last studio ended waits again."""
        for job in self._store.jobs():
            known = self._store.state(job)
            if known["state"] == "running":
                _end_left_run(known.get("process"), self._store.root / "jobs" / job)
                self._store.change(job, state="waiting", said="")
        self._thread.start()

    def stop(self) -> None:
        """End the process that runs, and the thread; the job goes on after a restart."""
        with self._wake:
            self._ending = True
            self._wake.notify_all()
        self.end_child()
        self._thread.join(2 * PATIENCE_S)

    def ask(self, job: str, want: str) -> None:
        """Queue a draft or the full design of a job that neither waits nor runs; it has no effect on others."""
        with self._wake:
            if self._store.state(job)["state"] not in ("waiting", "running"):
                self._store.change(job, state="waiting", want=want, said="")
            self._wake.notify_all()

    def wake(self) -> None:
        """Look for jobs that wait."""
        with self._wake:
            self._wake.notify_all()

    def cancel(self, job: str) -> None:
        """Stop a job that waits or runs; results that it has kept are used when it is asked for again."""
        with self._wake:
            running = job == self._running
            if running:
                self._cancelled = True
            elif self._store.state(job)["state"] == "waiting":
                self._store.change(job, state="cancelled", said="")
        if running:
            self.end_child()

    def _work(self) -> None:
        while True:
            with self._wake:
                while not self._ending and (job := self._next()) is None:
                    self._wake.wait()
                if self._ending:
                    return
                assert job is not None
                self._running, self._cancelled = job, False
                self._store.change(job, state="running", said="starting", done=0, began=time.time())
            self._run(job)

    def _next(self) -> str | None:
        return next((job for job in self._store.jobs() if self._store.state(job)["state"] == "waiting"), None)

    def _run(self, job: str) -> None:
        state = self._store.state(job)
        want = state["want"]
        settings = [word for value in state["draft"] for word in ("--set", value)] if want == "draft" else []
        code, last = self._command(job, "run", SPEC, "--out", want, "--sandbox", *settings)
        if code == 0:
            code, last = self._command(job, "view", want, "--no-open")
        if code == 0 and want == "full":
            code, last = self._command(job, "show", want, "--no-open")
        with self._wake:
            self._running = None
            if not self._ending:
                ended = "cancelled" if self._cancelled else "done" if code == 0 else "failed"
                took = state.get("took", {}) | ({want: time.time() - state["began"]} if ended == "done" else {})
                self._store.change(job, state=ended, said=last[:_MOST_WORDS] if ended == "failed" else "", took=took)

    def _command(self, job: str, *arguments: str) -> tuple[int, str]:
        """Exit code and last line of ``mlens`` in the job's folder."""
        with self._wake:
            if self._cancelled or self._ending:
                return 1, ""
            self._child = child = subprocess.Popen(
                [*self._program, *arguments],
                cwd=self._store.root / "jobs" / job,
                env=os.environ | {FOLDER_VARIABLE: str(self._store.root / "cache")},
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",
                start_new_session=True,  # Ctrl-C ends the studio, which ends the run in its own time
            )
            self._store.change(job, process=child.pid)
        assert child.stderr
        last = self._listen(job, child.stderr)
        child.stderr.close()
        return child.wait(), last

    def _listen(self, job: str, lines: IO[str]) -> str:
        """Note each line that a run prints as its progress; the last one, without a folder's path."""
        last, root = "", f"{self._store.root / 'jobs' / job}/"
        for done, line in enumerate(lines, 1):
            last = line.strip().replace(root, "") or last
            self._store.change(job, said=last[:_MOST_WORDS], done=done)
        return last

    def end_child(self) -> None:
        """End the run that goes on, if one does; it is killed if it does not end by itself."""
        child = self._child
        if child and child.poll() is None:
            child.terminate()
            try:
                child.wait(PATIENCE_S)
            except subprocess.TimeoutExpired:
                child.kill()


def _end_left_run(process: int | None, folder: Path) -> None:
    """End a run that was left alone when its studio was killed, so that no two runs fill one folder.

    Only Linux says where a process is at work. Elsewhere the run ends with the next line that it prints to nobody.
    """
    with suppress(OSError):  # it has ended
        for kind in (signal.SIGTERM, signal.SIGKILL):
            end = time.monotonic() + PATIENCE_S
            if process and _works_in(process, folder):
                os.kill(process, kind)
            while process and _works_in(process, folder) and time.monotonic() < end:
                time.sleep(0.05)


def _works_in(process: int, folder: Path) -> bool:
    return os.readlink(f"/proc/{process}/cwd") == str(folder.resolve())
