"""What a user can mend: each error says what is wrong, where, and what would mend it."""


class PeriscopyError(ValueError):
    """A mistake in what the user gave; the command line prints it as one line and exits with 2."""


class SceneError(PeriscopyError):
    """A scene file that breaks the id contract or that a model cannot treat."""


class PhotographError(PeriscopyError):
    """A photograph or an image that cannot be read or does not fit the scene."""


class OutputError(PeriscopyError):
    """An output path that cannot be written."""


class VariantError(PeriscopyError):
    """A Mitsuba variant that does not exist or does not work on this machine."""


class ConfigurationError(PeriscopyError):
    """A configuration file that cannot be read or asks for what does not exist."""


class DatasetError(PeriscopyError):
    """An archive that is not a data set, or not a whole one."""
