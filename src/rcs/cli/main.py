"""The entry point of the command `rcs`."""

from __future__ import annotations

import os
import sys
from typing import Annotated, Any

import tyro
from tyro.conf import subcommand

import rcs
from rcs.cli.collect import CollectCommand
from rcs.cli.console import let_all_text_out, plain_console
from rcs.cli.data import DataCommand
from rcs.cli.doctor import DoctorCommand
from rcs.cli.gallery import GalleryCommand
from rcs.cli.list import ListCommand
from rcs.errors import RcsError

Command = (
    Annotated[CollectCommand, subcommand("collect")]
    | Annotated[
        DataCommand,
        subcommand("data", description="Look at datasets, check, mend, edit, mix, replay, convert and view them."),
    ]
    | Annotated[GalleryCommand, subcommand("gallery")]
    | Annotated[ListCommand, subcommand("list")]
    | Annotated[DoctorCommand, subcommand("doctor")]
)


def main(arguments: list[str] | None = None) -> None:
    """Run a command and exit: 0 for success, 1 for an error or a bad finding, 130 when interrupted."""
    let_all_text_out()
    given = sys.argv[1:] if arguments is None else arguments
    if given == ["--version"]:
        print(f"rcs {rcs.__version__}")
        sys.exit(0)
    command: Any = tyro.cli(
        Command,  # pyright: ignore[reportArgumentType]  a union is a type to tyro
        prog="rcs",
        description="The Robot Control Stack.",
        args=arguments,
        config=(tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff),
    )
    sys.exit(run(command))


def run(command: Any) -> int:
    """Run a parsed command and return its exit code; errors of this library are shown without a traceback."""
    try:
        return command.run()
    except RcsError as err:
        return _failed(err)
    except BrokenPipeError:
        # Who read the output has seen enough; what is left of it must not fail at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as err:  # of the file system, where no function said more of it
        return _failed(err)
    except KeyboardInterrupt:
        return 130


def _failed(error: Exception) -> int:
    console = plain_console(stderr=True)
    console.print(f"error: {type(error).__name__}: {error}", style="bold red")
    return 1
