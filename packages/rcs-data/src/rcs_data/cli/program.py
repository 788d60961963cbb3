"""Commands of verbs: parses a command line, imports only what it needs, and shows errors without a traceback."""

from __future__ import annotations

import ast
import functools
import operator
import os
import re
import shutil
import signal
import sys
import textwrap
import threading
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, fields
from importlib.metadata import EntryPoint
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, cast

from rcs_data.errors import RcsError, UnknownName

Table = dict[str, str]
"""Verbs by name. Each is the `module:Name` of a dataclass with `run()`, or of a table of more verbs."""

_REFERENCE = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")
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
    """Its name, such as "rcs"."""
    verbs: Table
    """Its verbs."""
    version: str
    """The version that `--version` prints."""
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
        required = [field.default is MISSING and field.default_factory is MISSING for field in fields(found)]
        if not rest and not any(required):
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


def load(reference: str) -> Any:
    """Import and return `module:Name`."""
    return EntryPoint(name="", value=reference, group="").load()


def summary(reference: str) -> str:
    """Return the first sentence of the docstring of `module:Class`, or of the module if it is not a class.

    It is read from the source, since an import might import the simulator; only what the source does not mention is
    imported. Empty without a docstring.
    """
    place, _, name = reference.partition(":")
    source = _source(place)
    if source is not None and name in source.read_text("utf-8"):
        tree = ast.parse(source.read_bytes())
        node = next((node for node in tree.body if isinstance(node, ast.ClassDef) and node.name == name), tree)
        text = ast.get_docstring(node)
    else:
        text = load(reference).__doc__
    words = " ".join((text or "").strip().partition("\n\n")[0].split())
    return re.split(r"(?<=\.) ", words)[0]


def _source(module: str) -> Path | None:
    """Return the file of a module; its package is not imported either. None where it is not known."""
    top, *rest = module.split(".")
    spec = find_spec(top)
    if spec is None or not rest:
        origin = None if spec is None else spec.origin
        return Path(origin) if origin is not None and origin.endswith(".py") else None
    places = [Path(folder, *rest) for folder in spec.submodule_search_locations or ()]
    files = [file for place in places for file in (place.with_suffix(".py"), place / "__init__.py")]
    return next((file for file in files if file.is_file()), None)


def overview(program: str, table: Table, more: str = "") -> str:
    """Return the help of a command that has verbs, with a line or two for each, and more words at the end."""
    width = min(shutil.get_terminal_size().columns, 120)
    indent = max(map(len, table)) + 4
    lines = [f"usage: {program} COMMAND …", ""]
    for verb, reference in table.items():
        start = f"  {verb}".ljust(indent)
        lines.append(textwrap.fill(summary(reference), width, initial_indent=start, subsequent_indent=" " * indent))
    return "\n".join([*lines, "", f"`{program} COMMAND --help` describes a command and its options.{more}"])


def let_current_folder_be_imported(arguments: Sequence[str]) -> None:
    """If an argument is a `module:Class`, make modules of the current folder importable, as `python -m` does.

    The folder comes last on the path, so that no file in it shadows an installed module. Worker processes get the same
    path.
    """
    if any(_REFERENCE.fullmatch(argument.rpartition("=")[2]) for argument in arguments) and os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
