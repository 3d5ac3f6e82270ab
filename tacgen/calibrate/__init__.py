"""Sensor files fitted to measurements of one's own unit: lights to photographs, gels to forces."""
