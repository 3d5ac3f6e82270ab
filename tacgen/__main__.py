"""`python -m tacgen`."""

from tacgen.cli import app

if __name__ == "__main__":
    app()
