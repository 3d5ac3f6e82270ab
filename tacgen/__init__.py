"""tacgen: declarative recipes in, labelled datasets of vision-based tactile sensors out."""

__version__ = "0.1.0"
