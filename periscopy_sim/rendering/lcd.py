"""The LCD's angular emission profile, as a Mitsuba emitter plugin.

A liquid crystal display sends less light to the side than straight ahead. [15] fitted its radiance
as the normal radiance times cos^a of the vertical angle and cos^b of the horizontal angle, each
taken between the normal and the direction's projection on the plane of normal and up (or across).
"""

from typing import Any

from periscopy_sim.rendering.variant import PLUGINS, dr, mi

PLUGIN = "lcd"

EXPONENTS = "vertical_exponent", "horizontal_exponent"
"""Parameters of the angular profile."""


def falloff_about(surface: Any, direction: Any, exponents: tuple[float, float]) -> Any:
    """Evaluate the profile towards a world direction, about a surface point's own axes.

    It is 1 along the normal, 0 behind. cos(vertical angle) is n / sqrt(n² + u²) for a direction
    with normal component n and up component u, of any positive scale; likewise the horizontal one.
    The exponents are the vertical and the horizontal one.
    """
    across = dr.dot(direction, dr.normalize(surface.dp_du))
    up, normal = dr.dot(direction, dr.normalize(surface.dp_dv)), dr.dot(direction, surface.n)
    vertical, horizontal = exponents
    n2 = dr.square(normal)
    cos2_vertical = n2 / (n2 + dr.square(up))
    cos2_horizontal = n2 / (n2 + dr.square(across))
    value = _root_power(cos2_vertical, vertical) * _root_power(cos2_horizontal, horizontal)
    return dr.select(normal > 0, value, 0)


def _root_power(square: Any, exponent: float) -> Any:
    """Raise the root of a square to a power: by products where the exponent is a whole number."""
    if exponent != int(exponent):
        return dr.power(square, 0.5 * exponent)
    whole = dr.power(square, int(exponent) // 2)
    return whole * dr.sqrt(square) if int(exponent) % 2 else whole


def _surface_at(shape: Any, uv: Any, active: Any) -> Any:
    """Return a shape's surface at UV coordinates; of a mesh that has none, no surface.

    Such a monitor is rejected. But Dr.Jit traces every emitter that is still referenced, be it by
    the error's traceback, in renderings of other scenes too.
    """
    try:
        return shape.eval_parameterization(uv, +mi.RayFlags.All, active)
    except RuntimeError as error:
        if "does not have UV coordinates" not in str(error):
            raise
        return dr.zeros(mi.SurfaceInteraction3f)


def _solid_angle_density(pdf_uv: Any, surface: Any, ds: Any, active: Any) -> Any:
    """Turn a density over the UV square into one over directions; 0 at grazing."""
    cos_emission = -dr.dot(ds.d, surface.n)
    # At grazing the density overflows and would make the integrator's weights NaN.
    active = active & (cos_emission > 1e-6)
    area = dr.norm(dr.cross(surface.dp_du, surface.dp_dv))
    projected = dr.select(active, area * cos_emission, 1)
    return dr.select(active, pdf_uv * dr.square(ds.dist) / projected, 0)


def register_lcd(mitsuba: Any) -> None:
    """Register the ``lcd`` emitter with the variant now set of Mitsuba, the module itself.

    Its parameters are ``radiance`` (spectrum or texture: the radiance along the normal),
    ``vertical_exponent`` and ``horizontal_exponent``.
    """

    # Base classes belong to a variant, so the class is made anew for each.
    class Lcd(mitsuba.Emitter):  # type: ignore[misc]
        """Area emitter whose radiance falls off about the shape's own dp_du and dp_dv axes."""

        def __init__(self, props: Any) -> None:
            super().__init__(props)
            self.radiance = props.get_emissive_texture("radiance", 1.0)
            vertical, horizontal = (float(props.get(name, 0.0)) for name in EXPONENTS)
            self.exponents = vertical, horizontal
            varies = self.radiance.is_spatially_varying()
            self.m_flags = int(mi.EmitterFlags.Surface)
            self.m_flags |= int(mi.EmitterFlags.SpatiallyVarying) if varies else 0
            self.m_needs_sample_2 = self.m_needs_sample_3 = True

        def traverse(self, callback: Any) -> None:
            callback.put("radiance", self.radiance, mi.ParamFlags.Differentiable)

        def _emitted(self, surface: Any, direction: Any, active: Any) -> Any:
            profile = falloff_about(surface, direction, self.exponents)
            return self.radiance.eval(surface, active) * profile

        def eval(self, si: Any, active: Any = True) -> Any:
            return self._emitted(si, si.to_world(si.wi), active)

        def sample_direction(self, it: Any, sample: Any, active: Any = True) -> Any:
            uv, pdf_uv = self.radiance.sample_position(sample, active)
            surface = _surface_at(self.get_shape(), uv, active)
            ds = mi.DirectionSample3f()
            ds.p, ds.n, ds.uv = surface.p, surface.n, surface.uv
            ds.time, ds.delta = it.time, False
            to_light = surface.p - it.p
            ds.dist = dr.norm(to_light)
            ds.d = to_light / ds.dist
            ds.emitter = mi.EmitterPtr(self) if hasattr(mi, "EmitterPtr") else self
            active = active & surface.is_valid() & (pdf_uv > 0)
            ds.pdf = _solid_angle_density(pdf_uv, surface, ds, active)
            active = active & (ds.pdf > 0)
            radiance = self._emitted(surface, -ds.d, active)
            return ds, dr.select(active, radiance / dr.select(active, ds.pdf, 1), 0)

        def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            surface = _surface_at(self.get_shape(), ds.uv, active)
            pdf_uv = self.radiance.pdf_position(ds.uv, active)
            return _solid_angle_density(pdf_uv, surface, ds, active)

        def eval_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
            return self._emitted(_surface_at(self.get_shape(), ds.uv, active), -ds.d, active)

        def bbox(self) -> Any:
            return self.get_shape().bbox()

        def to_string(self) -> str:
            return f"Lcd[exponents={self.exponents}]"

    mitsuba.register_emitter(PLUGIN, Lcd)


PLUGINS.append(register_lcd)
