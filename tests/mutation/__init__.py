"""Mutation testing: would a room's own tests notice if one of its modules were wrong?"""
