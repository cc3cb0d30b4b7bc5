"""The answer of a query: how far apart two shapes are, or how deep they overlap, and where."""

import equinox as eqx

from jaxrb.math.arrays import Scalar, Vector


class Contact(eqx.Module):
    """Nearest points of two shapes a and b, or where they overlap the shortest way out.

    * `distance` (...) [m]: positive apart; negative overlapping, minus the length of the shortest translation of b
      that parts them.
    * `normal` (..., 3): unit vector from a to b in W. Moving b by −`distance` along it makes overlapping shapes touch.
    * `point_a`, `point_b` (..., 3) [m]: a witness on each shape in W; point_b − point_a = `distance` · `normal`.
    * `lower`, `upper` (...) [m]: the certificate. The true distance lies between them, round-off included; they come
      from a separating direction and from points of the shapes, not from the search's own idea of its error.
    """

    distance: Scalar
    normal: Vector
    point_a: Vector
    point_b: Vector
    lower: Scalar
    upper: Scalar

    def flipped(self) -> "Contact":
        """The same contact seen from b."""
        return Contact(self.distance, -self.normal, self.point_b, self.point_a, self.lower, self.upper)

    def grown(self, radius_a: Scalar, radius_b: Scalar) -> "Contact":
        """Of the shapes that reach farther by these radii [m] on all sides."""
        both = radius_a + radius_b
        return Contact(
            self.distance - both,
            self.normal,
            self.point_a + radius_a * self.normal,
            self.point_b - radius_b * self.normal,
            self.lower - both,
            self.upper - both,
        )
