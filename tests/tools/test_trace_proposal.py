"""A proposal is followed on a few screens: files and classes that it passes through are few."""

from tools.trace_proposal import traced_proposal


def test_a_proposal_passes_few_files_and_classes():
    trace = traced_proposal()  # 34 files and 26 classes in 0.2.0
    assert trace.functions["study/sampler/sampler.py", "FeatureKernelSampler.sample_relative"]
    assert len(trace.files) <= 10, sorted(trace.files)
    assert len(trace.classes) <= 10, sorted(trace.classes)
