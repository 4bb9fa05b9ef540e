"""What the user has to know and can mend."""


class Problem(Exception):
    """Ends the command with this message and an exit code."""

    def __init__(self, message: str, code: int = 2) -> None:
        super().__init__(message)
        self.code = code
