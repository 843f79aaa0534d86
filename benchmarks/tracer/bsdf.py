"""The paper's BRDF as a Mitsuba plugin, for scenes rendered by Mitsuba's own integrators.

After `register()` a scene may say ``{"type": "fipt_brdf", "base_color": ..., "roughness": ...,
"metallic": ...}``, each a texture, a mesh attribute or a value. Both sides of a surface reflect alike.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from fipt_blender.core.optics import brdf, factorised

PLUGIN_NAME = "fipt_brdf"


def register() -> None:
    """Register the plugin with the active Mitsuba variant; call it once for each variant."""

    class FiptBrdf(mi.BSDF):
        """a, sigma and m of paper Sec. 3 from textures; see `core.optics.brdf` for the functions."""

        def __init__(self, properties: mi.Properties) -> None:
            mi.BSDF.__init__(self, properties)
            self.base_color = properties.get_texture("base_color", 0.5)
            self.roughness = properties.get_texture("roughness", 0.5)
            self.metallic = properties.get_texture("metallic", 0.0)
            flags = (
                mi.BSDFFlags.GlossyReflection
                | mi.BSDFFlags.DiffuseReflection
                | mi.BSDFFlags.FrontSide
                | mi.BSDFFlags.BackSide
                | mi.BSDFFlags.SpatiallyVarying
            )
            self.m_components = [flags]
            self.m_flags = flags

        def traverse(self, callback: mi.TraversalCallback) -> None:
            differentiable = mi.ParamFlags.Differentiable
            callback.put("base_color", self.base_color, differentiable)
            callback.put("roughness", self.roughness, differentiable)
            callback.put("metallic", self.metallic, differentiable)

        def _material(self, si: mi.SurfaceInteraction3f, active: mi.Bool) -> brdf.Material:
            roughness = dr.clip(self.roughness.eval_1(si, active), brdf.MIN_ROUGHNESS, 1.0)
            return brdf.Material(
                self.base_color.eval(si, active), roughness, self.metallic.eval_1(si, active)
            )

        def sample(
            self,
            context: mi.BSDFContext,
            si: mi.SurfaceInteraction3f,
            sample1: mi.Float,
            sample2: mi.Point2f,
            active: mi.Bool = True,
        ) -> tuple[mi.BSDFSample3f, mi.Color3f]:
            viewer, behind = _viewer_side(si.wi)
            light, weight, pdf = brdf.sample(sample1, sample2, viewer, *self._material(si, active))
            active = mi.Bool(active) & (viewer.z > 0.0) & (pdf > 0.0)
            result = dr.zeros(mi.BSDFSample3f, dr.width(light))
            result.wo = _mirrored(light, behind)
            result.pdf = dr.select(active, pdf, 0.0)
            result.eta = 1.0
            result.sampled_type = mi.UInt32(+self.m_flags)
            result.sampled_component = mi.UInt32(0)
            return result, dr.select(active, weight, 0.0)

        def eval(
            self,
            context: mi.BSDFContext,
            si: mi.SurfaceInteraction3f,
            wo: mi.Vector3f,
            active: mi.Bool = True,
        ) -> mi.Color3f:
            return self.eval_pdf(context, si, wo, active)[0]

        def pdf(
            self,
            context: mi.BSDFContext,
            si: mi.SurfaceInteraction3f,
            wo: mi.Vector3f,
            active: mi.Bool = True,
        ) -> mi.Float:
            return self.eval_pdf(context, si, wo, active)[1]

        def eval_pdf(
            self,
            context: mi.BSDFContext,
            si: mi.SurfaceInteraction3f,
            wo: mi.Vector3f,
            active: mi.Bool = True,
        ) -> tuple[mi.Color3f, mi.Float]:
            viewer, behind = _viewer_side(si.wi)
            light = _mirrored(wo, behind)
            material = self._material(si, active)
            value = brdf.evaluate(light, viewer, *material)
            pdf = brdf.pdf(light, viewer, *material)
            return dr.select(active, value, 0.0), dr.select(active, pdf, 0.0)

        def eval_diffuse_reflectance(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Color3f:
            base_color, _, metallic = self._material(si, active)
            return factorised.diffuse_reflectance(base_color, metallic)

        def to_string(self) -> str:
            return f"FiptBrdf[{self.base_color}, {self.roughness}, {self.metallic}]"

    mi.register_bsdf(PLUGIN_NAME, FiptBrdf)


def _viewer_side(direction: mi.Vector3f) -> tuple[mi.Vector3f, mi.Bool]:
    """The direction mirrored to the upper hemisphere, and whether it was below."""
    behind = direction.z < 0.0
    return _mirrored(direction, behind), behind


def _mirrored(direction: mi.Vector3f, where: mi.Bool) -> mi.Vector3f:
    return mi.Vector3f(direction.x, direction.y, dr.select(where, -direction.z, direction.z))
