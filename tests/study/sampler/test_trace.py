"""A proposal is followed on a few screens: files and classes that it passes through are few."""

from tests.tools.running import load_tool

MOST = 10  # files, and classes; 34 and 26 in 0.2.0


def test_a_proposal_passes_few_files_and_classes() -> None:
    tool = load_tool("trace_proposal")
    calls = tool.calls_of_a_proposal()
    files, classes = tool.files_and_classes(calls)
    assert calls["study/sampler/sampler.py", "FeatureKernelSampler.sample_relative"]
    assert len(files) <= MOST and len(classes) <= MOST, (files, classes)
