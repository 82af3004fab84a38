defmodule Aerie.Vehicle.Collision.DetectorTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Collision.Detector

  @second 1_000_000

  defp boots(readings) do
    {verdicts, _} =
      Enum.map_reduce(readings, Detector.new(), fn {boot_ms, at}, detector ->
        {detector, verdict} = Detector.boot_time(detector, 30, boot_ms, round(at * @second))
        {verdict, detector}
      end)

    verdicts
  end

  defp places(readings) do
    {verdicts, _} =
      Enum.map_reduce(readings, Detector.new(), fn {place, at}, detector ->
        {detector, verdict} = Detector.position(detector, place, round(at * @second))
        {verdict, detector}
      end)

    verdicts
  end

  test "two alternating clocks are two vehicles" do
    readings = for n <- 0..9, reading <- [{60_000 + n * 500, n / 2}, {900_000 + n * 500, n / 2}], do: reading
    assert :two in boots(readings)
  end

  test "two links that bring one clock are one vehicle, also while it wraps" do
    wrap = 0x100000000
    readings = for n <- -10..10, late <- [0, 900], do: {Integer.mod(wrap + n * 200 - late, wrap), 100 + n / 5}
    assert Enum.uniq(boots(readings)) == [:one]
  end

  test "three alternating clocks are more than one vehicle" do
    readings = for n <- 0..9, reading <- [{60_000, n}, {900_000, n + 0.3}, {5_000_000, n + 0.6}], do: reading
    assert :two in boots(readings)
  end

  test "a clock that counts microseconds is one vehicle, even when it wraps" do
    readings = for n <- 0..100, do: {Integer.mod(4_290_000_000 + n * 200_000, 0x100000000), n / 5}
    assert Enum.uniq(boots(readings)) == [:one]
  end

  test "clocks are compared within one kind of message, and their number is bounded" do
    detector =
      for n <- 1..100, {id, boot_ms} <- [{30, n * 100}, {33, n * 100_000}], reduce: Detector.new() do
        detector ->
          with {detector, :one} <- Detector.boot_time(detector, id, boot_ms, n * 100_000), do: detector
      end

    detector =
      Enum.reduce(100..200, detector, fn id, detector ->
        detector |> Detector.boot_time(id, 0, 0) |> elem(0)
      end)

    assert map_size(detector.boot_times) == 16
  end

  test "a reboot, and a second one, is one vehicle" do
    readings = for(n <- 0..9, do: {60_000 + n * 1000, n}) ++ for(n <- 0..9, do: {n * 1000, 20 + n})
    assert Enum.uniq(boots(readings ++ for(n <- 0..9, do: {n * 1000, 60 + n}))) == [:one]
  end

  test "a link that is two seconds late is one vehicle" do
    readings = for n <- 10..40, reading <- [{n * 500, n / 2}, {n * 500 - 2000, n / 2}], do: reading
    assert Enum.uniq(boots(readings)) == [:one]
  end

  test "a second link that is half a minute late is one vehicle, vehicles on two links are two" do
    verdicts = fn late_ms ->
      readings =
        for n <- 100..130, {link, late} <- [{"a", 0}, {"b", late_ms}], do: {n * 500 - late, n / 2, link}

      Enum.map_reduce(readings, Detector.new(), fn {boot_ms, at, link}, detector ->
        {detector, verdict} = Detector.boot_time(detector, 30, boot_ms, round(at * @second), link)
        {verdict, detector}
      end)
    end

    assert {late, _detector} = verdicts.(20_000)
    assert Enum.uniq(late) == [:one]
    assert {two, detector} = verdicts.(45_000)
    assert :two in two
    assert Detector.paths(detector, {:boot_time, 30}) == {["a"], ["b"]}
  end

  test "paths stay bounded, and a uid shows by which path it came" do
    detector =
      Enum.reduce(1..100, Detector.new(), fn n, detector ->
        detector |> Detector.type({2, 3}, n, n) |> elem(0)
      end)

    assert {links, []} = Detector.paths(detector, :type)
    assert length(links) == 8
    {detector, :one} = Detector.uid(Detector.new(), "A", "a")
    {detector, :two} = Detector.uid(detector, "B", "b")
    assert Detector.paths(detector, :uid) == {["b"], ["a"]}
  end

  test "two alternating positions are two vehicles; a single jump is not, and the date line is not a jump" do
    home = {47.4, 8.5}
    far = {47.5, 8.5}
    assert :two in places(for n <- 0..9, reading <- [{home, n / 2}, {far, n / 2}], do: reading)
    assert Enum.uniq(places([{home, 0}, {far, 1}, {far, 2}, {home, 60}, {home, 61}])) == [:one]
    crossing = for n <- 0..20, do: {{0.0, if(rem(n, 2) == 0, do: 179.9999, else: -179.9999)}, n / 10}
    assert Enum.uniq(places(crossing)) == [:one]
  end

  test "slow changes to and fro are one vehicle" do
    home = {47.4, 8.5}
    far = {47.5, 8.5}
    readings = for n <- 0..20, do: {if(rem(n, 2) == 0, do: home, else: far), n * 10}
    assert Enum.uniq(places(readings)) == [:one]
  end

  test "another unique id is another vehicle, after a reboot another board" do
    {detector, :one} = Detector.uid(Detector.new(), "A")
    {detector, :one} = Detector.uid(detector, nil)
    {detector, :one} = Detector.uid(detector, "A")
    assert {_, :two} = Detector.uid(detector, "B")
    assert {_, :one} = Detector.uid(Detector.new(), "B")
  end
end
