"""A proposal is followed on a few screens: files and classes that it passes through are few."""

from tools.trace_proposal import traced_proposal

MOST_FILES, MOST_CLASSES = 21, 18  # 34 and 26 in 0.2.0; both become 10


def test_a_proposal_passes_few_files_and_classes():
    trace = traced_proposal()
    assert trace.functions["study/sampler/feature_sampler.py: FeatureKernelSampler.sample_relative"]
    assert len(trace.files) <= MOST_FILES, sorted(trace.files)
    assert len(trace.classes) <= MOST_CLASSES, sorted(trace.classes)
