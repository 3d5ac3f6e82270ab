"""`python -m tacgen`."""

from tacgen.cli.main import app

if __name__ == "__main__":
    app()
