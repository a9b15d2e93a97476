"""Configs: conversion to typed objects, and error messages."""
