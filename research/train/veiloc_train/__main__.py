"""`python -m veiloc_train inversion|positions|neighbours`."""

import argparse

from . import inversion, neighbours, positions


def main() -> None:
    parser = argparse.ArgumentParser(prog="veiloc_train", description="Trains networks of attacks and exports them as ONNX.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for module in (inversion, positions, neighbours):
        name = module.__name__.rpartition(".")[2]
        summary = module.__doc__.splitlines()[0]
        command = commands.add_parser(name, help=summary, description=summary)
        module.add_arguments(command)
        command.set_defaults(run=module.run)
    args = parser.parse_args()
    args.run(args)


if __name__ == "__main__":
    main()
