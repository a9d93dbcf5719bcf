"""The `odaf` command."""


def main(arguments: list[str] | None = None) -> int:
    return 0
