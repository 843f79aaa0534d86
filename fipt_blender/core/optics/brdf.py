"""The paper's BRDF as Dr.Jit functions in the local shading frame (z is the normal).

Paper Sec. 3, Eq. 1: f = kd/pi cos_i + F D G / (4 cos_o), the cosine included, with GGX D (alpha = sigma^2)
and Schlick's F = ks F0 + F1 (Eq. 7). The paper does not specify G: the default is Schlick-Smith with
k = (sigma + 1)^2 / 8, as in the authors' data; a run may choose Cycles' G instead (`set_masking`). Baking,
refinement and forward rendering all use this module.

Directions point away from the surface. `wo` is towards the viewer, `wi` towards the light.
"""

from __future__ import annotations

from typing import NamedTuple

import drjit as dr
import mitsuba as mi

from .factorised import diffuse_reflectance, specular_reflectance

MIN_COSINE = 1e-4  # below it, a direction counts as edge-on
MIN_ROUGHNESS = 0.02  # of the paper's range of roughness
MASKINGS = ("schlick", "smith")

_masking = MASKINGS[0]


class Material(NamedTuple):
    """Parameters of the BRDF at surface points: a, sigma and m of paper Sec. 3."""

    base_color: mi.Color3f
    roughness: mi.Float
    metallic: mi.Float


class BrdfSample(NamedTuple):
    """A direction drawn by :func:`sample`; weight and pdf are zero where it is below the horizon.

    Attributes:
        wi: unit direction towards the light, local.
        weight: f / pdf, the cosine included.
        pdf: solid-angle density.
    """

    wi: mi.Vector3f
    weight: mi.Color3f
    pdf: mi.Float


def set_masking(masking: str) -> None:
    """Choose G, one of MASKINGS, for this process."""
    global _masking
    if masking not in MASKINGS:
        raise ValueError(f"unknown masking '{masking}', choose one of {MASKINGS}")
    _masking = masking


def ggx_distribution(h: mi.Vector3f, alpha: mi.Float) -> mi.Float:
    """GGX normal distribution D(h) in 1/sr of a unit half vector; zero below the horizon.

    Written with sin^2 = x^2 + y^2: near the peak of sharp lobes (alpha ~ 4e-4) 1 - cos^2 cancels.
    """
    alpha2 = dr.square(alpha)
    sin2 = dr.fma(h.x, h.x, dr.square(h.y))
    return dr.select(h.z > 0.0, alpha2 / (dr.pi * dr.square(dr.fma(alpha2, dr.square(h.z), sin2))), 0.0)


def geometry_term(cos_i: mi.Float, cos_o: mi.Float, roughness: mi.Float) -> mi.Float:
    """Shadowing-masking G chosen by `set_masking`.

    Schlick-Smith with k = (sigma + 1)^2 / 8, or Smith's height-correlated G for GGX: E. Heitz,
    "Understanding the Masking-Shadowing Function in Microfacet-Based BRDFs", JCGT 3(2), 2014, Eq. 99.
    """
    if _masking == "smith":
        alpha2 = dr.square(dr.square(roughness))
        both = cos_i * dr.sqrt(dr.fma(1.0 - alpha2, dr.square(cos_o), alpha2))
        both += cos_o * dr.sqrt(dr.fma(1.0 - alpha2, dr.square(cos_i), alpha2))
        return 2.0 * cos_i * cos_o / both
    k = dr.square(roughness + 1.0) * 0.125
    return cos_i * cos_o / (dr.fma(cos_i, 1.0 - k, k) * dr.fma(cos_o, 1.0 - k, k))


def fresnel_terms(cos_d: mi.Float) -> tuple[mi.Float, mi.Float]:
    """(F0, F1) of F = ks F0 + F1 (paper Eq. 7); `cos_d` is h.wi."""
    x = dr.maximum(1.0 - cos_d, 0.0)
    x2 = dr.square(x)
    f1 = x2 * x2 * x
    return 1.0 - f1, f1


def specular_lobes(wi: mi.Vector3f, wo: mi.Vector3f, roughness: mi.Float) -> tuple[mi.Float, mi.Float]:
    """(F0 D G / (4 cos_o), F1 D G / (4 cos_o)), the integrands of L_s0 and L_s1 (paper Eq. 6), in 1/sr."""
    h = dr.normalize(wi + wo)
    cos_i, cos_o = wi.z, wo.z
    lit = (cos_i > MIN_COSINE) & (cos_o > MIN_COSINE)
    d = ggx_distribution(h, dr.square(roughness))
    dg = dr.select(lit, d * geometry_term(cos_i, cos_o, roughness) / (4.0 * cos_o), 0.0)
    f0, f1 = fresnel_terms(dr.dot(h, wi))
    return f0 * dg, f1 * dg


def evaluate(
    wi: mi.Vector3f, wo: mi.Vector3f, base_color: mi.Color3f, roughness: mi.Float, metallic: mi.Float
) -> mi.Color3f:
    """The BRDF times the cosine (paper Eq. 1), in 1/sr."""
    s0, s1 = specular_lobes(wi, wo, roughness)
    diffuse = dr.select((wi.z > 0.0) & (wo.z > 0.0), wi.z * dr.inv_pi, 0.0)
    return (
        diffuse_reflectance(base_color, metallic) * diffuse
        + specular_reflectance(base_color, metallic) * s0
        + s1
    )


def visible_normal_pdf(wi: mi.Vector3f, wo: mi.Vector3f, roughness: mi.Float) -> mi.Float:
    """Solid-angle density of `wi` from :func:`sample_visible_normal`."""
    alpha = dr.square(roughness)
    h = dr.normalize(wi + wo)
    cos_o = dr.maximum(wo.z, MIN_COSINE)
    alpha2 = dr.square(alpha)
    # Smith's G1(wo) / (4 cos_o) in one fraction
    smith = 0.5 / (cos_o + dr.sqrt(dr.fma(1.0 - alpha2, dr.square(cos_o), alpha2)))
    valid = (wi.z > 0.0) & (wo.z > 0.0)
    return dr.select(valid, ggx_distribution(h, alpha) * smith, 0.0)


def sample_visible_normal(sample: mi.Point2f, wo: mi.Vector3f, roughness: mi.Float) -> mi.Vector3f:
    """Direction `wi`: `wo` reflected at a visible GGX normal; may point below the horizon.

    Spherical-cap construction: J. Dupuy and A. Benyoub, "Sampling Visible GGX Normals with Spherical
    Caps", 2023.
    """
    alpha = dr.square(roughness)
    stretched = dr.normalize(mi.Vector3f(alpha * wo.x, alpha * wo.y, dr.maximum(wo.z, MIN_COSINE)))
    phi = 2.0 * dr.pi * sample.x
    z = dr.fma(1.0 - sample.y, 1.0 + stretched.z, -stretched.z)
    sin_theta = dr.safe_sqrt(1.0 - dr.square(z))
    sin_phi, cos_phi = dr.sincos(phi)
    cap = mi.Vector3f(sin_theta * cos_phi, sin_theta * sin_phi, z) + stretched
    h = dr.normalize(mi.Vector3f(alpha * cap.x, alpha * cap.y, dr.maximum(cap.z, 1e-7)))
    return 2.0 * dr.dot(wo, h) * h - wo


def specular_probability(base_color: mi.Color3f, metallic: mi.Float) -> mi.Float:
    """Share of samples that :func:`sample` spends on the specular lobe."""
    kd = dr.mean(diffuse_reflectance(base_color, metallic))
    ks = dr.mean(specular_reflectance(base_color, metallic))
    return dr.clip(ks / dr.maximum(kd + ks, 1e-6), 0.1, 0.95)


def pdf(
    wi: mi.Vector3f, wo: mi.Vector3f, base_color: mi.Color3f, roughness: mi.Float, metallic: mi.Float
) -> mi.Float:
    """Solid-angle density of :func:`sample`."""
    share = specular_probability(base_color, metallic)
    cosine = dr.select((wi.z > 0.0) & (wo.z > 0.0), wi.z * dr.inv_pi, 0.0)
    return share * visible_normal_pdf(wi, wo, roughness) + (1.0 - share) * cosine


def sample(
    choice: mi.Float,
    sample2: mi.Point2f,
    wo: mi.Vector3f,
    base_color: mi.Color3f,
    roughness: mi.Float,
    metallic: mi.Float,
) -> BrdfSample:
    """Sample the BRDF.

    Args:
        choice: uniform number that picks the lobe.
        sample2: two uniform numbers.
    """
    share = specular_probability(base_color, metallic)
    specular = sample_visible_normal(sample2, wo, roughness)
    diffuse = mi.warp.square_to_cosine_hemisphere(sample2)
    wi = dr.select(choice < share, specular, diffuse)
    density = pdf(wi, wo, base_color, roughness, metallic)
    valid = (wi.z > 0.0) & (density > 0.0)
    value = evaluate(wi, wo, base_color, roughness, metallic)
    return BrdfSample(wi, dr.select(valid, value / density, 0.0), dr.select(valid, density, 0.0))
