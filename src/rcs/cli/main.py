"""The entry point of the command `rcs`."""

from __future__ import annotations

import functools
import operator
import os
import sys
from dataclasses import MISSING, Field, fields
from typing import Annotated, Any, cast

from rcs.cli.verbs import Table, let_current_folder_be_imported, load, overview
from rcs.errors import RcsError, UnknownName

VERBS: Table = {
    "collect": "rcs.cli.collect:CollectCommand",
    "train": "rcs.cli.train:TrainCommand",
    "eval": "rcs.cli.eval:EvalCommand",
    "run": "rcs.cli.run:RunCommand",
    "data": "rcs.cli.data:VERBS",
    "calibrate": "rcs.cli.calibrate:VERBS",
    "sim": "rcs.cli.sim:SimCommand",
    "ik": "rcs.cli.ik:IkCommand",
    "plan": "rcs.cli.plan:PlanCommand",
    "twin": "rcs.cli.twin:TwinCommand",
    "gallery": "rcs.cli.gallery:GalleryCommand",
    "list": "rcs.cli.list:ListCommand",
    "doctor": "rcs.cli.doctor:DoctorCommand",
}
OPTIONS = ("--help", "--version", "--print-completion")
OPTIONS_HELP = """
`rcs --version` prints the version.
`rcs --print-completion bash` (or zsh, fish) prints a completion script for that shell."""
SHELLS = ("bash", "zsh", "fish")
MISTYPED = 2
"""Exit code for an invalid command line, as in tyro and shells."""


def main(arguments: list[str] | None = None) -> None:
    """Run a command and exit: 0 for success, 1 for an error or bad finding, 2 if invalid, 130 if interrupted."""
    _let_all_text_out()
    try:
        try:
            sys.exit(_answer(sys.argv[1:] if arguments is None else arguments))
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        # The reader of the output has closed it; flushing the rest must not fail at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


def _answer(words: list[str]) -> int:
    """Run a command line and return its exit code; help and wrong options exit."""
    let_current_folder_be_imported(words)
    if words == ["--version"]:
        from rcs import __version__

        print(f"rcs {__version__}")
        return 0
    try:
        if words[:1] == ["--print-completion"]:
            _print_completion(*words[1:2])
        command = _parse("rcs", VERBS, words)
    except UnknownName as err:
        return _failed(str(err), MISTYPED)
    except RcsError as err:  # from a module that cannot work here
        return _failed(f"{type(err).__name__}: {err}")
    return run(command)


def run(command: Any) -> int:
    """Run a parsed command and return its exit code; errors of this library are shown without a traceback."""
    try:
        return command.run()
    except BrokenPipeError:  # the reader of the output is gone
        raise
    except (RcsError, OSError) as err:  # file system errors that no function has explained
        return _failed(f"{type(err).__name__}: {err}")
    except KeyboardInterrupt:
        return 130


def _parse(program: str, table: Table, words: list[str]) -> Any:
    """Return the command of a command line, importing only its module. Help and wrong options exit.

    Raises:
        UnknownName: There is no such command; the message suggests the nearest one.
    """
    if not words or words[0] in ("-h", "--help"):
        text = overview(program, table, OPTIONS_HELP if table is VERBS else "")
        print(text, file=sys.stdout if words else sys.stderr)
        sys.exit(0 if words else MISTYPED)
    verb, *rest = words
    if verb not in table:
        if verb.startswith("-"):
            raise UnknownName("option", verb, OPTIONS)
        elsewhere = verb in load(VERBS["data"])
        raise UnknownName("command", verb, table, f"There is `rcs data {verb}`." if elsewhere else "")
    found = load(table[verb])
    if isinstance(found, dict):
        return _parse(f"{program} {verb}", cast(Table, found), rest)
    if not rest and not any(_is_required(field) for field in fields(found)):
        return found()  # there is nothing to parse, and importing tyro takes as long as many commands
    import tyro

    return tyro.cli(found, prog=f"{program} {verb}", args=rest, config=_how_to_parse())


def _is_required(field: Field[Any]) -> bool:
    return field.default is MISSING and field.default_factory is MISSING


def _how_to_parse() -> tuple[Any, ...]:
    from tyro import conf

    return (conf.OmitArgPrefixes, conf.FlagCreatePairsOff)


def _print_completion(shell: str = "") -> None:
    """Print a shell's completion script and exit; this imports all commands.

    Raises:
        UnknownName: The shell is not supported.
    """
    if shell not in SHELLS:
        raise UnknownName("completion for a shell", shell, SHELLS)
    import tyro

    arguments = ["--tyro-write-completion", shell, "-"]
    tyro.cli(_union(VERBS), prog="rcs", args=arguments, config=_how_to_parse())


def _union(table: Table) -> Any:
    from tyro.conf import subcommand

    found = {verb: load(reference) for verb, reference in table.items()}
    kinds = {verb: _union(cast(Table, each)) if isinstance(each, dict) else each for verb, each in found.items()}
    return functools.reduce(operator.or_, (Annotated[kind, subcommand(verb)] for verb, kind in kinds.items()))


def _failed(message: str, code: int = 1) -> int:
    from rcs.cli.console import plain_console

    plain_console(stderr=True).print(f"error: {message}", style="bold red")
    return code


def _let_all_text_out() -> None:
    """Print characters unknown to the terminal's encoding as escapes instead of failing."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(errors="backslashreplace")
