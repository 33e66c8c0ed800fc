"""Where installed scripts of earlier versions enter."""

from .main import main as main
