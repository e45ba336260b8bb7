"""What the user is told when a command cannot be done."""


class CommandError(Exception):
    """One sentence for the user, and the exit status: 2 for bad input, 1 for a failed run."""

    def __init__(self, message: str, status: int = 2) -> None:
        super().__init__(message)
        self.status = status
