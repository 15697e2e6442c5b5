"""A proposal is followed on a few screens: files and classes that it passes through are few."""

from tools.trace_proposal import traced_proposal

MOST_FILES, MOST_CLASSES = 10, 10  # 34 and 26 in 0.2.0


def test_a_proposal_passes_few_files_and_classes():
    trace = traced_proposal()
    assert trace.functions["study/sampler/sampler.py", "FeatureKernelSampler.sample_relative"]
    assert len(trace.files) <= MOST_FILES, sorted(trace.files)
    assert len(trace.classes) <= MOST_CLASSES, sorted(trace.classes)
