"""A recipe to which a test only adds its trajectory: a ball on a coarse mesh of the GelSight Mini, forces alone."""

HEAD = """
tacgen: 1
name: small
sensor: gelsight_mini
indenter: {shape: sphere, radius_mm: 4.0}
outputs: [force]
quality: {edge_mm: 1.0, dhat_mm: 0.1}
trajectory:
"""
