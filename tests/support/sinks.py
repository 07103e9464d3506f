"""A sink for tests: a file of records by itself, which no run's other files go with."""

from facetrack_cli.core.files import FileSink, publish


class Alone(FileSink):
    """Gives the file its name when it ends."""

    def finish(self, tail):
        try:
            super().finish(tail)
        finally:
            publish(self.path)
