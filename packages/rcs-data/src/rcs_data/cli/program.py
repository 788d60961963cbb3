"""Commands of verbs: parses a command line, imports only what it asks for, and shows errors without a traceback."""

from __future__ import annotations

import functools
import operator
import os
import signal
import sys
import threading
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, Field, dataclass, fields
from typing import Annotated, Any, cast

from rcs_data.cli.verbs import Table, let_current_folder_be_imported, load, overview
from rcs_data.errors import RcsError, UnknownName

OPTIONS = ("--help", "--version", "--print-completion")
SHELLS = ("bash", "zsh", "fish")
MISTYPED = 2
"""Exit code for an invalid command line, as in tyro and shells."""
INTERRUPTED = 130
"""Exit code after Ctrl-C, as in shells."""


@dataclass(frozen=True)
class Program:
    """A command that has verbs."""

    name: str
    """What is typed, such as "rcs"."""
    verbs: Table
    """Its verbs."""
    version: str
    """What `--version` prints."""
    elsewhere: Mapping[str, str] | None = None
    """Verbs that people look for here, and where they are, such as "info" and "rcs data info"."""

    def main(self, words: list[str]) -> None:
        """Run a command and exit: 0 for success, 1 for an error or bad finding, 2 if invalid, 130 if interrupted."""
        _let_all_text_out()
        try:
            try:
                sys.exit(self._answer(words))
            finally:
                sys.stdout.flush()
        except BrokenPipeError:
            # The reader of the output has closed it; flushing the rest must not fail at exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            sys.exit(1)

    def _answer(self, words: list[str]) -> int:
        """Run a command line and return its exit code; help and wrong options exit."""
        let_current_folder_be_imported(words)
        if words == ["--version"]:
            print(f"{self.name} {self.version}")
            return 0
        try:
            with _ended_by_interrupts():
                if words[:1] == ["--print-completion"]:
                    self._print_completion(*words[1:2])
                command = self._parse(self.name, self.verbs, words)
        except UnknownName as err:
            return _failed(str(err), MISTYPED)
        except RcsError as err:  # from a module that cannot work here
            return _failed(f"{type(err).__name__}: {err}")
        return run(command)

    def _parse(self, typed: str, table: Table, words: list[str]) -> Any:
        """Return the command of a command line, importing only its module. Help and wrong options exit.

        Raises:
            UnknownName: There is no such command; the message suggests the nearest one.
        """
        if not words or words[0] in ("-h", "--help"):
            text = overview(typed, table, self._options_help() if table is self.verbs else "")
            print(text, file=sys.stdout if words else sys.stderr)
            sys.exit(0 if words else MISTYPED)
        verb, *rest = words
        if verb not in table:
            if verb.startswith("-"):
                raise UnknownName("option", verb, OPTIONS)
            there = (self.elsewhere or {}).get(verb)
            raise UnknownName("command", verb, table, f"There is `{there}`." if there else "")
        found = load(table[verb])
        if isinstance(found, dict):
            return self._parse(f"{typed} {verb}", cast(Table, found), rest)
        if not rest and not any(_is_required(field) for field in fields(found)):
            return found()  # there is nothing to parse, and importing tyro takes as long as many commands
        return _parsed(found, prog=f"{typed} {verb}", args=rest)

    def _options_help(self) -> str:
        return (
            f"\n`{self.name} --version` prints the version."
            f"\n`{self.name} --print-completion bash` (or zsh, fish) prints a completion script for that shell."
        )

    def _print_completion(self, shell: str = "") -> None:
        """Print a shell's completion script and exit; this imports all commands.

        Raises:
            UnknownName: The shell is not supported.
        """
        if shell not in SHELLS:
            raise UnknownName("completion for a shell", shell, SHELLS)
        _parsed(_union(self.verbs), prog=self.name, args=["--tyro-write-completion", shell, "-"])


def run(command: Any) -> int:
    """Run a parsed command and return its exit code; errors of this library are shown without a traceback."""
    try:
        return command.run()
    except BrokenPipeError:  # the reader of the output is gone
        raise
    except (RcsError, OSError) as err:  # file system errors that no function has explained
        # One that only passes on another has the other's name in front already.
        is_named = type(err) is RcsError and str(err).startswith(f"{type(err.__cause__).__name__}: ")
        return _failed(str(err) if is_named else f"{type(err).__name__}: {err}")
    except KeyboardInterrupt:
        return INTERRUPTED


@contextmanager
def _ended_by_interrupts() -> Generator[None]:
    """Let Ctrl-C end the process at once while nothing but imports is done; extensions make other errors of it."""
    before = signal.getsignal(signal.SIGINT)
    if before is not signal.default_int_handler or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, lambda number, frame: os._exit(INTERRUPTED))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _is_required(field: Field[Any]) -> bool:
    return field.default is MISSING and field.default_factory is MISSING


def _parsed(kind: Any, *, prog: str, args: list[str]) -> Any:
    import tyro

    from rcs_data.cli.options import REGISTRY

    return tyro.cli(kind, prog=prog, args=args, config=(tyro.conf.OmitArgPrefixes,), registry=REGISTRY)


def _union(table: Table) -> Any:
    from tyro.conf import subcommand

    found = {verb: load(reference) for verb, reference in table.items()}
    kinds = {verb: _union(cast(Table, each)) if isinstance(each, dict) else each for verb, each in found.items()}
    return functools.reduce(operator.or_, (Annotated[kind, subcommand(verb)] for verb, kind in kinds.items()))


def _failed(message: str, code: int = 1) -> int:
    from rcs_data.cli.console import plain_console

    plain_console(stderr=True).print(f"error: {message}", style="bold red")
    return code


def _let_all_text_out() -> None:
    """Print characters unknown to the terminal's encoding as escapes instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="backslashreplace")
