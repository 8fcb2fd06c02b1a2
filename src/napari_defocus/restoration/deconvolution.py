"""Non-blind deconvolution with the point spread function of every pixel's own scale, (19).

What is minimised over pictures f, with the blur A of (1), the picture g and weights w, is a data
term and a regularization, the total variation (TV) rounded at 0,

    sum_x w_x |(A f)[x] - g[x]|^2 + lambda sum_x sqrt(|grad f[x]|^2 + eps^2),

where |grad f|^2 is the sum over both directions and all channels: edges of the channels lie at
the same places. As a prior, it says that pictures have few and steep edges. It is solved by
iteratively reweighted least squares (IRLS; half-quadratic regularization: Geman and Reynolds,
IEEE PAMI 14(3), 1992; lagged diffusivity: Vogel and Oman, SIAM J. Sci. Comput. 17(1), 1996). Each
round replaces the second sum by the quadratic sum_x c_x |grad f[x]|^2 that touches it from above.
Its IRLS weights are c = lambda / (2 sqrt(|grad f|^2 + eps^2)) of the present f. Then some steps of
preconditioned conjugate gradients (PCG) go towards the solution of

    (A' w A + grad' c grad) f = A' w g.

The preconditioner consists of Wiener-like filters on overlapping tiles, each with its own scale. In
a tile the blur is nearly constant, and the filter gives back what it takes away. Without the
preconditioner, ten times as many steps are not enough.

All is in units of the picture's contrast, also the constants below.

Photographs do not fit (1) as simulations do, because lenses, maps and depth edges are not exactly
as it says. After a few rounds, the residual is compared with what noise leaves; see `_misfit`. The
misfit then counts as more noise, which is smoothed away, and less of the blur is taken away.

The domain is larger than the picture by the reach of the PSF; there are no data around the picture.
Clipped highlights are data on one side only: they do not count once A f is at least as bright.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, minimum_filter
from scipy.special import erfinv

from napari_defocus.core.checks import Linearize
from napari_defocus.core.compiled import compiled
from napari_defocus.core.image import PreparedImage, decode_srgb
from napari_defocus.core.progress import Progress
from napari_defocus.core.threads import in_bands
from napari_defocus.forward.blur_operator import BlurOperator, half_variance_slope
from napari_defocus.psf.families import PSFFamily
from napari_defocus.restoration.preconditioner import TiledPreconditioner

Float32 = NDArray[np.float32]

_DOUBT, _DOUBT_POWER = 2.0, 3
"""The error of a radius, in px, that counts where the confidence is 0, and the power of one minus
the confidence with which it falls. Chosen by hand; that an error of 0.03 r + 0.05 px everywhere
lost is in docs/decisions.md.
"""

_SILENCE = 1e-8
"""The least noise variance, in units of the squared contrast: without it, data without noise would
outweigh everything. Chosen by hand.
"""

_CLIPPED = 1 - 1 / 255
"""Intensity from which on light counts as clipped: the last level but one of 8 bits."""

_FIRST_EPSILON, _LEAST_EPSILON = 0.02, 1e-3
"""eps, in units of the contrast, of the first round and from which on it no longer halves. Chosen
by hand.
"""

_STEPS_A_ROUND, _MOST_ROUNDS, _USUAL_ROUNDS = 5, 25, 8
"""PCG steps a round, rounds at most, and rounds that pictures usually need, for the progress: 30
to 40 steps (docs/decisions.md). The first two are chosen by hand.
"""

_TOLERANCE = 3e-3
"""A round that changes less than this share of the picture's norm is the last. Chosen by hand."""

_CHECKED_AFTER = (2, 4)
"""Rounds, from 0, after which scales that explain nothing are reduced (docs/decisions.md)."""

_GROSS = 8.0
"""How many times the noise the residual's local power must be. With 3, the gain on ramps fell to
6.6 dB (docs/decisions.md).
"""

_VISIBLE = 2e-5
"""Added to the noise variance in this, in units of the squared contrast (docs/decisions.md)."""

_PROBED_AFTER = 2
"""The round, from 0, after which the misfit is measured."""

_FITS, _FAILS = 1.2, 3.0
"""Geometric mean of the residual's power over the picture, in units of the noise: up to the first
value the picture fits, from the second on it does not (docs/decisions.md).
"""

_LEFT_BY_TV = 2e-7
"""The least power, in units of the squared contrast, that a residual is compared with: what the
least lambda leaves in pictures without noise.
"""

_MISFIT = 0.0075
"""Variance of the misfit of photographs, as a share of the picture's (docs/decisions.md)."""

_TV_OF_MISFIT = 30.0
"""lambda of (19): so many times the variance of the misfit, as of the noise."""

_LOWERED = (0.25, 1.25)
"""Standard deviations by which scales are lowered in the two pictures that are averaged, where the
model does not fit: around the 10 % quantile of a normal distribution, if the map is that of 30 %
(docs/decisions.md).
"""

_TOLERATED, _LARGEST_DEVIATION = 0.5, 3.0
"""px: the error that `confidence_map` tolerates, and the largest standard deviation that is derived
from a confidence.
"""

_MISFIT_ROUNDS = 4
"""Rounds for each of the two pictures: a large lambda settles sooner."""

_LEAST_SHARE_WITHIN = 1e-3
"""The least erfinv of the confidence, so that it can be divided by."""

_LEAST_POWER = 1e-3
"""Least power of the residual in the geometric mean, in units of the noise variance."""

_RESIDUAL_SIGMA, _RESIDUAL_REACH = 3.0, 4
"""px: the Gaussian over which the residual's power is averaged, and how far around the scale is
reduced. Chosen by hand.
"""

_LEAST_KNOWN = 0.05
"""A residual counts if at least this share of its surroundings is not clipped. By hand."""

_LEAST_SHARE, _UNCHANGED = 0.5, 0.95
"""The smallest factor by which a scale is reduced at once; above the second factor it stays. By
hand.
"""

_TRANSFORMED_FROM = 12.0
"""px: scale from which on Fourier transforms of tiles are faster than sums (docs/decisions.md)."""

_PRECONDITIONED_TV = 15.0
"""The constant IRLS weight c that the preconditioner assumes for the TV: that of a gradient of 1/30
of the contrast. Chosen by hand.
"""


class Deconvolution:
    """(19) for one picture, whose map may still change.

    Parameters
    ----------
    picture : PreparedImage
    psf : PSFFamily
    sure : (H, W) float32 ndarray or None
        How sure the map is, 0 to 1; None if it is right.
    noise_variance, tv_weight : float
    linearize : {"srgb"} or None
        What the picture was decoded by: it says where light is clipped.
    pool : Executor
        What filters at once.
    follows_misfit : bool
        Whether `tv_weight` grows where the picture does not fit the model.
    hides_misfit : bool
        Whether the noise is so large that a misfit would not be seen: then there is one.

    Attributes
    ----------
    misfit : float
        Variance of what lens and map do not explain, in units of the squared intensity; 0 if
        the picture fits. Known after `solve`.
    left_over : (H, W, C) float32 ndarray or None
        What the restored picture, blurred again, leaves of the given one, if that does not fit.
        Known after `solve`.
    """

    def __init__(
        self,
        picture: PreparedImage,
        psf: PSFFamily,
        sure: Float32 | None,
        noise_variance: float,
        tv_weight: float,
        linearize: Linearize | None,
        pool: Executor,
        *,
        follows_misfit: bool = True,
        hides_misfit: bool = False,
    ) -> None:
        unit = self._unit = np.float32(picture.intensities.unit)
        self._color, self._opaque = picture.color / unit, picture.opaque
        self._psf, self._sure, self._pool = psf, sure, pool
        # Not NumPy's numbers: they would turn pictures into double precision.
        self._noise_variance = float(max(noise_variance / float(unit) ** 2, _SILENCE))
        self._tv_weight = float(tv_weight / float(unit))
        limit = np.array([_CLIPPED], np.float32)
        clipped = picture.color >= (decode_srgb(limit) if linearize == "srgb" else limit)
        self._clipped = clipped if clipped.any() else None
        self._follows_misfit, self._hides_misfit = follows_misfit, hides_misfit
        self._misfit_variance = 0.0
        self.left_over: Float32 | None = None

    @property
    def misfit(self) -> float:
        """Variance of what is not explained, see the attributes."""
        return self._misfit_variance * float(self._unit) ** 2

    @property
    def tv_weight(self) -> float:
        """Of (19), as it was used, in units of the intensity."""
        return self._tv_weight * float(self._unit)

    def solve(self, scales: Float32, progress: Progress) -> Float32:
        """Return the minimiser, (H, W, C); nothing keeps it in [0, 1].

        Of a picture that does not fit, return what `_despite_misfit` does.
        """
        if self._hides_misfit:
            return self._despite_misfit(scales, 1.0, progress) * self._unit
        sharp = self._begun(scales)
        epsilon = _FIRST_EPSILON
        for count in range(_MOST_ROUNDS):
            start, whole = _STEPS_A_ROUND * count, _STEPS_A_ROUND * _USUAL_ROUNDS
            before = sharp.copy()
            for step in self._pcg_steps(sharp, epsilon):
                progress("Taking the blur away", min((start + step) / whole, 1.0))
            change = sharp - before
            settled = _inner(change, change) < _TOLERANCE**2 * _inner(sharp, sharp)
            if epsilon <= _LEAST_EPSILON and settled:
                break
            epsilon = max(epsilon / 2, _LEAST_EPSILON)
            if count == _PROBED_AFTER and (share := self._misfit(sharp)) > 0:
                return self._despite_misfit(scales, share, progress) * self._unit
            if count in _CHECKED_AFTER and self._sure is not None:
                scales, sharp = self._with_less_blur(scales, sharp)
        return sharp[self._blur.inner] * self._unit

    def _begun(self, scales: Float32) -> Float32:
        """Take scales for the blur; return the picture, filtered once, on the domain."""
        self._blur_by(scales)
        sharp = self._blur.extend(self._color)
        sharp += self._preconditioner(self._negative_gradient(sharp)[0])
        return sharp

    def _misfit(self, sharp: Float32) -> float:
        """Return how much of the usual misfit a picture has, 0 to 1, from the residual.

        If lens and map are right, f explains the picture up to a part of the noise. The geometric
        mean says so of most of the picture; a few wrong places do not matter to it. Where the
        residual is large does not tell where the model is wrong: what fits it there is in f.
        """
        power = self._residual_power(sharp) / max(self._noise_variance, _LEFT_BY_TV)
        middle = float(np.exp(np.mean(np.log(np.maximum(power, _LEAST_POWER)), dtype=np.float64)))
        return float(np.clip((middle - _FITS) / (_FAILS - _FITS), 0, 1))

    def _despite_misfit(self, scales: Float32, share: float, progress: Progress) -> Float32:
        """Return the mean of two pictures, each with less of the blur taken away.

        The misfit counts as noise, for data weights and lambda. What a large lambda takes from
        the picture beside its noise, its fine texture, is given back.
        """
        self._misfit_variance = share * _MISFIT * float(np.mean(self._color.var(axis=(0, 1))))
        self._noise_variance += self._misfit_variance
        if self._follows_misfit:
            self._tv_weight += _TV_OF_MISFIT * self._misfit_variance
        noise = self._noise_variance - self._misfit_variance
        deviations = (0.0,) if self._sure is None else _LOWERED
        sharp, left_over = np.zeros_like(self._color), np.zeros_like(self._color)
        whole = _STEPS_A_ROUND * _MISFIT_ROUNDS * len(deviations)
        probed = (_PROBED_AFTER + 1) / _USUAL_ROUNDS
        for number, lowered in enumerate(deviations):
            one = self._begun(self._lowered(scales, share * lowered))
            epsilon = _FIRST_EPSILON
            for count in range(_MISFIT_ROUNDS):
                start = _STEPS_A_ROUND * (_MISFIT_ROUNDS * number + count)
                for step in self._pcg_steps(one, epsilon):
                    done = probed + (1 - probed) * (start + step) / whole
                    progress("Taking less blur away: the lens or the map may not fit", done)
                epsilon = max(epsilon / 2, _LEAST_EPSILON)
            error = self._error(one)
            sharp += one[self._blur.inner] + share * _texture(error, noise)
            left_over += error
        sharp /= np.float32(len(deviations))
        self.left_over = left_over * np.float32(share * self._unit / len(deviations))
        return sharp

    def _lowered(self, scales: Float32, deviations: float) -> Float32:
        """Return scales lowered by so many standard deviations of a normal distribution.

        That which is right to half a px with the probability that the confidence says.
        """
        if self._sure is None:
            return scales
        within = np.maximum(erfinv(np.minimum(self._sure, 0.999)), _LEAST_SHARE_WITHIN)
        deviation = np.minimum(_TOLERATED / (np.sqrt(2) * within), _LARGEST_DEVIATION)
        return np.maximum(scales - deviations * deviation, 0).astype(np.float32)

    def _error(self, sharp: Float32) -> Float32:
        """Return g - A f, where light is known."""
        error = self._color - self._blur.apply(sharp)
        if self._clipped is not None:
            error[self._clipped & (error < 0)] = 0
        if self._opaque is not None:
            error *= self._opaque[..., None]
        return error

    def _residual_power(self, sharp: Float32) -> Float32:
        """Return the local power of g - A f, (H, W), where light is not clipped."""
        error = self._blur.apply(sharp) - self._color
        square, known = np.mean(error**2, axis=2), np.ones(error.shape[:2], np.float32)
        if self._clipped is not None:
            known[self._clipped.any(axis=2)] = 0
        if self._opaque is not None:
            known *= self._opaque
        power = gaussian_filter(square * known, _RESIDUAL_SIGMA)
        power /= np.maximum(gaussian_filter(known, _RESIDUAL_SIGMA), _LEAST_KNOWN)
        return power

    def _blur_by(self, scales: Float32) -> None:
        self._blur = BlurOperator(scales, self._psf, self._color.shape[2], _TRANSFORMED_FROM)
        self._weight = self._weights(scales)
        weight, regularization = self._weight[..., 0], _PRECONDITIONED_TV * self._tv_weight
        self._preconditioner = TiledPreconditioner(
            self._blur, scales, self._psf, weight, regularization, self._pool
        )

    def _weights(self, scales: Float32) -> Float32:
        """Return the weights w of the data, (H, W, 1): noise over noise and other errors.

        A scale that is wrong by d px changes g by about d (dv/dr) / 2 laplace g, by the heat
        equation, with the variance v(r) of the PSF, see `half_variance_slope`.
        """
        weight = np.ones((*scales.shape, 1), np.float32)
        if self._sure is not None:
            change = half_variance_slope(self._psf, scales)[..., None] * _laplacian(self._color)
            doubt = _DOUBT * (1 - self._sure[..., None]) ** _DOUBT_POWER
            wrong = np.mean((doubt * change) ** 2, axis=2, keepdims=True)
            weight = self._noise_variance / (self._noise_variance + wrong)
        if self._opaque is not None:
            weight = weight * self._opaque[..., None]
        return weight.astype(np.float32)

    def _negative_gradient(self, sharp: Float32) -> tuple[Float32, Float32]:
        """Return that of half the data term, A' w (g - A f), and the w in use.

        It is 0 where light was clipped and A f is bright enough.
        """
        error = self._color - self._blur.apply(sharp)
        weight = self._weight
        if self._clipped is not None:
            weight = np.where(self._clipped & (error < 0), np.float32(0), weight)
        error *= weight
        return self._blur.adjoint(error), weight

    def _pcg_steps(self, sharp: Float32, epsilon: float) -> Iterator[int]:
        """Go one round of preconditioned conjugate gradient steps, in place; tell before each."""
        residual, weight = self._negative_gradient(sharp)
        irls_weights = _irls_weights(sharp, np.float32(self._tv_weight), np.float32(epsilon))
        residual -= _graph_laplacian(irls_weights, sharp)
        preconditioned = self._preconditioner(residual)
        direction = preconditioned.copy()
        power = _inner(residual, preconditioned)
        for step in range(_STEPS_A_ROUND):
            yield step
            product = self._blur.adjoint(weight * self._blur.apply(direction))
            product += _graph_laplacian(irls_weights, direction)
            curvature = _inner(direction, product)
            if not (power > 0 and curvature > 0):
                return
            length = power / curvature
            sharp += length * direction
            residual -= length * product
            preconditioned = self._preconditioner(residual)
            power, last = _inner(residual, preconditioned), power
            direction *= power / last
            direction += preconditioned

    def _with_less_blur(self, scales: Float32, sharp: Float32) -> tuple[Float32, Float32]:
        """Reduce the scales where the result does not explain the picture, and start anew there.

        Too small a scale leaves blur, but hardly an error. With too large a one, or two depths
        under one PSF, only a picture full of rings would explain the data.
        """
        power = self._residual_power(sharp)
        expected = _GROSS * (self._noise_variance + _VISIBLE)
        share = np.sqrt(expected / np.maximum(power, expected))
        share = minimum_filter(np.maximum(share, _LEAST_SHARE), 2 * _RESIDUAL_REACH + 1)
        share = gaussian_filter(share, _RESIDUAL_REACH)
        if share.min() > _UNCHANGED:
            return scales, sharp
        picture = sharp[self._blur.inner]
        anew = np.clip((1 - share) / (1 - _UNCHANGED), 0, 1)[..., None]
        scales = (scales * share).astype(np.float32)
        self._blur_by(scales)
        return scales, self._blur.extend(picture + anew * (self._color - picture))


def _inner(a: Float32, b: Float32) -> float:
    """Return the sum of products, in one order: `numpy.vdot` has one for each processor."""
    return float(np.sum(a * b, dtype=np.float64))


def _texture(error: Float32, noise: float) -> Float32:
    """Return what f does not explain, less the share of it that is noise."""
    power = max(float(np.mean(error**2, dtype=np.float64)), noise)
    return error * np.float32(1 - noise / power)


def _laplacian(color: Float32) -> Float32:
    padded = np.pad(color, ((1, 1), (1, 1), (0, 0)), mode="symmetric")
    around = padded[2:, 1:-1] + padded[:-2, 1:-1] + padded[1:-1, 2:] + padded[1:-1, :-2]
    return around - 4 * color


def _irls_weights(picture: Float32, tv_weight: np.float32, epsilon: np.float32) -> Float32:
    """Return c = lambda / (2 sqrt(|grad f|^2 + eps^2)): (H, W)."""
    irls_weights = np.empty(picture.shape[:2], np.float32)
    in_bands(_irls_weight_rows, len(picture), picture, tv_weight, epsilon, irls_weights)
    return irls_weights


@compiled
def _irls_weight_rows(
    start: int,
    stop: int,
    picture: Float32,
    tv_weight: np.float32,
    epsilon: np.float32,
    irls_weights: Float32,
) -> None:
    height, width, channels = picture.shape
    for row in range(start, stop):
        for column in range(width):
            square = epsilon * epsilon
            for channel in range(channels):
                if row + 1 < height:
                    step = picture[row + 1, column, channel] - picture[row, column, channel]
                    square += step * step
                if column + 1 < width:
                    step = picture[row, column + 1, channel] - picture[row, column, channel]
                    square += step * step
            irls_weights[row, column] = np.float32(0.5) * tv_weight / np.sqrt(square)


def _graph_laplacian(irls_weights: Float32, picture: Float32) -> Float32:
    """Return grad' (c grad f): half the gradient of sum_x c_x |grad f[x]|^2.

    c_x weighs the differences to the next row and column.
    """
    laplacian = np.empty_like(picture)
    in_bands(_graph_laplacian_rows, len(picture), irls_weights, picture, laplacian)
    return laplacian


@compiled
def _graph_laplacian_rows(
    start: int, stop: int, irls_weights: Float32, picture: Float32, laplacian: Float32
) -> None:
    height, width, channels = picture.shape
    for row in range(start, stop):
        for column in range(width):
            own = irls_weights[row, column]
            up = irls_weights[row - 1, column] if row > 0 else np.float32(0)
            left = irls_weights[row, column - 1] if column > 0 else np.float32(0)
            above, below = max(row - 1, 0), min(row + 1, height - 1)
            before, after = max(column - 1, 0), min(column + 1, width - 1)
            for channel in range(channels):
                value = picture[row, column, channel]
                laplacian[row, column, channel] = (
                    own * (value - picture[below, column, channel])
                    + own * (value - picture[row, after, channel])
                    + up * (value - picture[above, column, channel])
                    + left * (value - picture[row, before, channel])
                )
