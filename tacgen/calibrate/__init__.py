"""Sensor files fitted to measurements of one's own unit: lights to photographs, gels to forces.

The files in the order of the work; the commands are `optics`, `material` and `unit`, each with its report:

    photographs   photos, contact_circle
    presses       press_faces, press_forces (at known depths), ball_dents, press_colours (at depths that are found)
    fit           light_equations, robust_search, fit_lights, fit_scattering, fit_material, fit_unit
    check         normal_net, likeness, unseen, plausible (which alone writes sensor files)
    command       optics, material, unit
"""
