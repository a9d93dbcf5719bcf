"""A conditional variational auto-encoder: what is drawn given a condition, through a latent variable z.

    z ~ q(z | condition, target) = N(mean, std^2) while training,   output = decoder(condition, z)

(Kingma & Welling 2014; Sohn et al. 2015.) What the output means, and so the reconstruction loss, is the user's: a next
state, an action before or after a tanh, a mean and a log standard deviation.
"""

import equinox as eqx
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, PRNGKeyArray

from odaf.components.distributions import gaussian_divergence
from odaf.components.networks import MLP, init_mlp

KL_WEIGHT = 0.5  # of BCQ's code and its descendants, beside means over rows and dimensions
PRIOR_CLIP = 0.5


class CVAE(eqx.Module):
    """Encoder and decoder.

    With `sees_target` the encoder sees condition and target while training, and z comes from the clipped prior
    afterwards. Without, it sees the condition alone, as ODAF's and OSR's released codes have it: such an encoder can
    carry nothing about the target, and z is noise whose spread depends on the condition.
    """

    encoder: MLP
    decoder: MLP
    sees_target: bool = eqx.field(static=True, default=True)
    log_std_range: tuple[float, float] | None = eqx.field(static=True, default=None)  # of q; BCQ's is (-4, 15)

    @property
    def latent_dim(self) -> int:
        """Width of z."""
        return self.encoder.weights[-1].shape[-1] // 2

    def encode(
        self, condition: Float[Array, "rows condition_dim"], target: Float[Array, "rows target_dim"] | None = None
    ) -> tuple[Float[Array, "rows latent_dim"], Float[Array, "rows latent_dim"]]:
        """Mean and log standard deviation of q; the target is looked at only with `sees_target`."""
        if self.sees_target:
            if target is None:
                raise TypeError("an encoder that sees the target needs one")
            condition = jnp.concatenate([condition, target], axis=-1)
        mean, log_std = jnp.split(self.encoder(condition), 2, axis=-1)
        return mean, log_std if self.log_std_range is None else jnp.clip(log_std, *self.log_std_range)

    def decode(
        self, condition: Float[Array, "rows condition_dim"], latent: Float[Array, "rows latent_dim"]
    ) -> Float[Array, "rows output_dim"]:
        """The decoder's output."""
        return self.decoder(jnp.concatenate([condition, latent], axis=-1))

    def latent_for(
        self, condition: Float[Array, "rows condition_dim"], normal: Float[Array, "rows latent_dim"]
    ) -> Float[Array, "rows latent_dim"]:
        """z where there is no target, for standard normal noise: the noise clipped to +-0.5, or through the encoder."""
        if self.sees_target:
            return jnp.clip(normal, -PRIOR_CLIP, PRIOR_CLIP)
        return reparameterised(*self.encode(condition), normal)

    def reconstruct(
        self,
        condition: Float[Array, "rows condition_dim"],
        target: Float[Array, "rows target_dim"] | None,
        normal: Float[Array, "rows latent_dim"],
    ) -> tuple[Float[Array, "rows output_dim"], Float[Array, "rows latent_dim"], Float[Array, "rows latent_dim"]]:
        """The decoder's output for a z drawn from q, and q's mean and log standard deviation; for training."""
        mean, log_std = self.encode(condition, target)
        return self.decode(condition, reparameterised(mean, log_std, normal)), mean, log_std

    def draw_noise(self, key: PRNGKeyArray, rows: int) -> Float[Array, "rows latent_dim"]:
        """Standard normal noise for z."""
        return jr.normal(key, (rows, self.latent_dim))


def decoded_draws(
    decoder: MLP, condition: Float[Array, "rows condition_dim"], normal: Float[Array, "draws rows latent_dim"]
) -> Float[Array, "draws rows output_dim"]:
    """A decoder's outputs for several z of the clipped prior a row, for standard normal noise.

    What the condition adds to the first layer is computed once for all of them.
    """
    return decoder.of_draws(condition, jnp.clip(normal, -PRIOR_CLIP, PRIOR_CLIP))


def reparameterised(
    mean: Float[Array, "rows latent_dim"],
    log_std: Float[Array, "rows latent_dim"],
    normal: Float[Array, "rows latent_dim"],
) -> Float[Array, "rows latent_dim"]:
    """mean + std * noise, differentiable in mean and log_std."""
    return mean + jnp.exp(log_std) * normal


def latent_divergence(
    mean: Float[Array, "rows latent_dim"], log_std: Float[Array, "rows latent_dim"]
) -> Float[Array, "rows latent_dim"]:
    """KL( q || N(0, 1) ) of every row and dimension of z, in nats; not summed."""
    origin = jnp.zeros_like(mean)
    return gaussian_divergence(mean, log_std, origin, origin)


def init_cvae(
    key: PRNGKeyArray,
    condition_dim: int,
    target_dim: int,
    output_dim: int,
    latent_dim: int,
    *,
    encoder_sizes: tuple[int, ...],
    decoder_sizes: tuple[int, ...],
    sees_target: bool = True,
    log_std_range: tuple[float, float] | None = None,
) -> CVAE:
    """Draw both networks, with zero hidden biases.

    Args:
        key: random key.
        condition_dim: width of what the output is conditioned on.
        target_dim: width of what the encoder sees beside it while training.
        output_dim: width of the decoder's output.
        latent_dim: width of z.
        encoder_sizes: widths of the encoder's hidden layers.
        decoder_sizes: widths of the decoder's hidden layers.
        sees_target: whether the encoder sees the target.
        log_std_range: what the log standard deviation of q is clipped to; None does not clip it.
    """
    key_encoder, key_decoder = jr.split(key)
    seen = condition_dim + (target_dim if sees_target else 0)
    return CVAE(
        encoder=init_mlp(key_encoder, (seen, *encoder_sizes, 2 * latent_dim), hidden_bias=0.0),
        decoder=init_mlp(key_decoder, (condition_dim + latent_dim, *decoder_sizes, output_dim), hidden_bias=0.0),
        sees_target=sees_target,
        log_std_range=log_std_range,
    )
