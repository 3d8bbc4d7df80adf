"""Words for a person."""


def counted(number: int, noun: str) -> str:
    """A count with its noun: "1 agent", "2 agents"."""
    return f"{number} {noun}" + "s" * (number != 1)
