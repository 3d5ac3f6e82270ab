"""Rendering of camera images: methods, path tracer, Mitsuba's variants."""
