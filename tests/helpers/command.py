"""The command line in this process, as tests run it."""

from typer.testing import CliRunner, Result

from tacgen.cli.main import app


def tacgen_(*words: object) -> Result:
    """Run a command, by its words."""
    return CliRunner().invoke(app, list(map(str, words)))


def told(*words: object) -> str:
    """What a command prints that does what it is asked to."""
    done = tacgen_(*words)
    assert done.exit_code == 0, done.output
    return done.stdout


def refused(*words: object) -> str:
    """What a command says of a mistake of its user's."""
    done = tacgen_(*words)
    assert done.exit_code == 2, done.output
    return done.stderr
