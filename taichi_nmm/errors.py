"""The one exception a user of this project is meant to meet."""


class InputError(ValueError):
    """Input that cannot be used: one line naming the field, the value and what is allowed.

    Commands print the line and exit with code 2.
    """

    def __init__(self, field: str, value: object, allowed: str) -> None:
        self.field = field
        self.value = value
        self.allowed = allowed
        super().__init__(f"{field}: {value!r} cannot be used; allowed: {allowed}")

    def __reduce__(self) -> tuple[type, tuple[str, object, str]]:
        """What it is made of again, so that it can pass from one process to another."""
        return type(self), (self.field, self.value, self.allowed)
