from .study_report import write_report as write_report
from .templates import render as render
