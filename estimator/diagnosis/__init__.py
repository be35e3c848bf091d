"""Diagnosis of samples that contradict the parameters: have those changed, or does something else act?"""
