"""Maps of pressure, friction and contact on the deformed coated face."""

from tacgen.outputs.base import Datasets, DrawnMap, Entry, FrameData, Output, number


def _frame(frame: FrameData) -> Datasets:
    from tacgen.outputs.contact_maps import resultant_errors

    out = {f"/frames/{name}": getattr(frame.maps, name) for name in ("pressure", "traction", "contact")}
    errors = resultant_errors(frame.shares, frame.touched, frame.state, frame.maps)
    out |= {f"/frames/quality/{name}_resultant": value for name, value in errors.items()}
    out["/frames/quality/unseen_force"] = frame.maps.unseen
    slid = {f"/frames/{name}": getattr(frame.maps, name) for name in ("slip", "sliding")}
    return out if frame.state.sliding is None else out | slid


OUTPUT = Output(
    "maps of pressure, traction, contact, and with friction slip and the share that slides",
    {
        "/frames/pressure": Entry("<f4", "N h w", "MPa", "pressure normal to the deformed coated face", bits=13),
        "/frames/traction": Entry("<f4", "N h w 2", "MPa", "friction on the gel, in the tangent plane", bits=13),
        "/frames/contact": Entry("|b1", "N h w", "1", "in contact"),
        "/frames/slip": Entry("|b1", "N h w", "1", "in contact, and half or more of the pressure slides"),
        "/frames/sliding": Entry("<f4", "N h w", "1", "share of the pressure that slides, 0 to 1", power=-10),
        "/frames/quality/pressure_resultant": number(
            "integral of -pressure n da less the normal contact forces, over force"
        ),
        "/frames/quality/traction_resultant": number("integral of traction da less friction, over force"),
        "/frames/quality/unseen_force": number(
            "share of the normal forces that pressure and traction do not show: on gel hidden by other gel, or outside"
            " the picture"
        ),
    },
    _frame,
    maps={
        "pressure": DrawnMap("pressure [MPa]", "viridis", "/frames/pressure"),
        "traction": DrawnMap("traction [MPa]", "magma", "/frames/traction"),
    },
)
