"""The command ``evis``: the same program as ``evis-rs``, and commands that are written in Python."""

from __future__ import annotations

import contextlib
import os
import signal
import sys

from . import _commands, _evis


def main() -> int:
    """Run the command line and return its exit code."""
    if "EVIS_FFMPEG" not in os.environ:
        # The extra `video` brings an ffmpeg; without it, one on PATH is looked for.
        with contextlib.suppress(ImportError, RuntimeError):
            import imageio_ffmpeg

            os.environ["EVIS_FFMPEG"] = imageio_ffmpeg.get_ffmpeg_exe()
    arguments = sys.argv[1:]
    if arguments and arguments[0] in _commands.COMMANDS:
        return _commands.run(arguments[0], arguments[1:])
    if arguments[:1] == ["help"] and arguments[1:] and arguments[1] in _commands.COMMANDS:
        return _commands.run(arguments[1], ["--help"])
    # The program looks for Ctrl-C itself; Python's handler would only report it once more afterwards.
    with contextlib.suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _evis.run_cli(["evis", *arguments])


if __name__ == "__main__":
    sys.exit(main())
