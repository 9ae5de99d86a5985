"""Conditions of a drive, such as noise or grip, and domains: how often they and roads occur."""
