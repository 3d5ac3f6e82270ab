"""Sensor files fitted to measurements of one's own unit: lights to photographs, gels to forces.

Commands, each with its report and the changes of the sensor file
    optics                  lights, coating and camera from photographs of ball presses
    material                moduli and relaxation of the gel from a table of depths and forces
    unit                    gel thickness, moduli, zero of the gauge and lights from photographed presses with forces

Measurements
    photos                  read the photographs and their table
    contact_circle          refine the contact circle of a photographed press
    press_localisation      find depth and centre of photographed presses, and the colours by slope

Solved presses (finite elements)
    solved_presses          face of the gel under a photographed ball
    dent_tables             force and face of a ball over the depth, for gels of several thicknesses
    dent_family             the same for all thicknesses, interpolated between solved ones
    force_curves            force over the depth, and the table of measured forces

Fits
    photometric_model       equations of pixels, linear in the LEDs' radiances, for a clear gel
    robust_least_squares    soft-l1 Gauss-Newton steps on these equations
    photometric_fit         lights, coating and camera of a sensor with a clear gel
    contrast_fit            contrast of the lights, from forces that a network reads
    scattering_fit          lights and response to thickness of a gel that scatters
    material_fit            moduli and relaxation, with confidence intervals
    indentation_fit         thickness, moduli, zero and lag of a gauge, with confidence intervals

Progress
    steps                   what goes on, told to listeners; work on all cores

Checks
    cross_validation        scores on presses that a fit has not seen
    render_comparison       rendered against photographed presses: contrast, error of normals
    normal_net              network from colours to normals, for that error
    integrable_normals      normals of one surface, from those that the network finds pixel by pixel
    sensor_fit              plausibility of a fit; the only place that writes sensor files
"""
