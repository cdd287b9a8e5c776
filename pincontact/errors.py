"""Typed errors. Each message names the contact, the frame or the number that was out of bounds."""

from __future__ import annotations


def sentence(text: str) -> str:
    """A message as a sentence: with a full stop at its end, if it has none and does not end otherwise.

    Messages often end in a number, a name or another message, which may bring a full stop of its own.
    """
    text = text.rstrip()
    return text if not text or text.endswith((".", "!", "?")) else f"{text}."


class ContactError(Exception):
    """Base of every error raised by pincontact. Its message ends in a full stop."""

    def __init__(self, message: str = "") -> None:
        super().__init__(*([sentence(message)] if message else []))


class ModelError(ContactError, ValueError):
    """The robot model, its file or one of its frames cannot be used."""


class ContourError(ContactError, ValueError):
    """A contour's shape, domain or placement is out of bounds."""


class UnusableResult(ContourError):
    """What a user's function returned is not what it was asked for.

    A run ends with that as its message. Where there is no run, only the motions of contours are asked.
    """


class PatternError(ContactError, ValueError):
    """Two contours do not form one of the seven contact patterns, or not the one asked for."""


class FrictionError(ContactError, ValueError):
    """A friction law has a parameter out of bounds."""


class StateError(ContactError, ValueError):
    """A configuration, velocity or torque has the wrong size, is not finite or is not normalised."""


class NoContactError(ContactError):
    """The contours of a contact do not touch in the given configuration.

    Attributes
    ----------
    gap : float
        Distance in m between the contours at the nearest candidate point, NaN if there is none.
    """

    def __init__(self, message: str, gap: float = float("nan")):
        super().__init__(message)
        self.gap = gap


class SingularContactError(ContactError):
    """The location equations (Eq. 6) are singular: the point contact degenerates to a line or an area.

    Attributes
    ----------
    conditioning : float
        The dimensionless measure of J that fell below its threshold.
    """

    def __init__(self, message: str, conditioning: float = float("nan")):
        super().__init__(message)
        self.conditioning = conditioning


class ArgumentError(ContactError, ValueError):
    """An argument of a call is out of bounds."""


class SolverError(ContactError):
    """A numerical problem has no solution, or none was found; the message carries the residual."""


class InfeasibleError(SolverError):
    """A contact problem provably has no solution, or wanted accelerations are out of reach.

    Attributes
    ----------
    certificate : (n,) array or FarkasCertificate, optional
        Of `solve_contacts` normal forces y that move nothing (G y = 0) while the contacts they press approach
        (b . y < 0); of `inverse_dynamics` a `FarkasCertificate`.
    """

    def __init__(self, message: str, certificate: object = None):
        super().__init__(message)
        self.certificate = certificate


class TrajectoryError(ContactError):
    """A stored trajectory cannot be read, or what was asked of it was not recorded."""


class SceneFileError(ContactError, ValueError):
    """A scene file cannot be read; the message names the file, the key and what was expected there."""


class MissingExtraError(ContactError, ImportError):
    """An optional package is needed for this call; the message names the extra that installs it."""
