"""What can go wrong, each with what to do next."""


class TerracrawlerError(RuntimeError):
    """Everything that this package raises on its own."""


class ProgramNotFoundError(TerracrawlerError):
    """There is no program ``terracrawler`` where it was looked for."""


class ProgramEndedError(TerracrawlerError):
    """The program ended, or refused what it was asked; the message has the last lines that it said."""


class ProtocolError(TerracrawlerError):
    """The program answered what this package does not understand: they are of different versions."""


class EpisodeOverError(TerracrawlerError):
    """A world was to act that has no episode: reset first."""
