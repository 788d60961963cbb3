"""The entry point of the command `rcs`."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import tyro
from rich.console import Console
from tyro.conf import subcommand

from rcs.cli.collect import CollectCommand
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
        console = Console(stderr=True, soft_wrap=True)
        console.print(f"error: {type(err).__name__}: {err}", style="bold red", highlight=False, markup=False)
        return 1
    except KeyboardInterrupt:
        return 130
