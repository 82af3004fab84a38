defmodule Aerie.Vehicle.TwinTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Twin

  @second 1_000_000

  defp boots(readings) do
    {verdicts, _} =
      Enum.map_reduce(readings, Twin.new(), fn {boot_ms, at}, twin ->
        {twin, verdict} = Twin.boot(twin, 30, boot_ms, round(at * @second))
        {verdict, twin}
      end)

    verdicts
  end

  defp places(readings) do
    {verdicts, _} =
      Enum.map_reduce(readings, Twin.new(), fn {place, at}, twin ->
        {twin, verdict} = Twin.place(twin, place, round(at * @second))
        {verdict, twin}
      end)

    verdicts
  end

  test "two clocks in turn are two vehicles" do
    readings = for n <- 0..9, reading <- [{60_000 + n * 500, n / 2}, {900_000 + n * 500, n / 2}], do: reading
    assert :two in boots(readings)
  end

  test "three clocks in turn are more than one vehicle" do
    readings = for n <- 0..9, reading <- [{60_000, n}, {900_000, n + 0.3}, {5_000_000, n + 0.6}], do: reading
    assert :two in boots(readings)
  end

  test "a clock that counts microseconds is one vehicle, over its wrap too" do
    readings = for n <- 0..100, do: {Integer.mod(4_290_000_000 + n * 200_000, 0x100000000), n / 5}
    assert Enum.uniq(boots(readings)) == [:one]
  end

  test "clocks are compared within one kind of message, of which there are a few" do
    twin =
      for n <- 1..100, {id, boot_ms} <- [{30, n * 100}, {33, n * 100_000}], reduce: Twin.new() do
        twin -> with {twin, :one} <- Twin.boot(twin, id, boot_ms, n * 100_000), do: twin
      end

    twin = Enum.reduce(100..200, twin, fn id, twin -> twin |> Twin.boot(id, 0, 0) |> elem(0) end)
    assert map_size(twin.boot) == 16
  end

  test "a reboot, and a second one, is one vehicle" do
    readings = for(n <- 0..9, do: {60_000 + n * 1000, n}) ++ for(n <- 0..9, do: {n * 1000, 20 + n})
    assert Enum.uniq(boots(readings ++ for(n <- 0..9, do: {n * 1000, 60 + n}))) == [:one]
  end

  test "a link that is two seconds late is one vehicle" do
    readings = for n <- 10..40, reading <- [{n * 500, n / 2}, {n * 500 - 2000, n / 2}], do: reading
    assert Enum.uniq(boots(readings)) == [:one]
  end

  test "a second link that is half a minute late is one vehicle, a vehicle on each link are two" do
    verdicts = fn late_ms ->
      readings =
        for n <- 100..130, {link, late} <- [{"a", 0}, {"b", late_ms}], do: {n * 500 - late, n / 2, link}

      Enum.map_reduce(readings, Twin.new(), fn {boot_ms, at, link}, twin ->
        {twin, verdict} = Twin.boot(twin, 30, boot_ms, round(at * @second), link)
        {verdict, twin}
      end)
    end

    assert {late, _twin} = verdicts.(20_000)
    assert Enum.uniq(late) == [:one]
    assert {two, twin} = verdicts.(45_000)
    assert :two in two
    assert Twin.links(twin, {:boot, 30}) == {["a"], ["b"]}
  end

  test "links stay bounded, and a uid tells by which it came" do
    twin = Enum.reduce(1..100, Twin.new(), fn n, twin -> twin |> Twin.kind({2, 3}, n, n) |> elem(0) end)
    assert {links, []} = Twin.links(twin, :kind)
    assert length(links) == 8
    {twin, :one} = Twin.uid(Twin.new(), "A", "a")
    {twin, :two} = Twin.uid(twin, "B", "b")
    assert Twin.links(twin, :uid) == {["b"], ["a"]}
  end

  test "two places in turn are two vehicles; a jump is not, and the date line is no jump" do
    home = {47.4, 8.5}
    far = {47.5, 8.5}
    assert :two in places(for n <- 0..9, reading <- [{home, n / 2}, {far, n / 2}], do: reading)
    assert Enum.uniq(places([{home, 0}, {far, 1}, {far, 2}, {home, 60}, {home, 61}])) == [:one]
    crossing = for n <- 0..20, do: {{0.0, if(rem(n, 2) == 0, do: 179.9999, else: -179.9999)}, n / 10}
    assert Enum.uniq(places(crossing)) == [:one]
  end

  test "changes of side over a long time are no twins" do
    home = {47.4, 8.5}
    far = {47.5, 8.5}
    readings = for n <- 0..20, do: {if(rem(n, 2) == 0, do: home, else: far), n * 10}
    assert Enum.uniq(places(readings)) == [:one]
  end

  test "another unique id without a reboot is another vehicle; with one it is another board" do
    {twin, :one} = Twin.uid(Twin.new(), "A")
    {twin, :one} = Twin.uid(twin, nil)
    {twin, :one} = Twin.uid(twin, "A")
    assert {_, :two} = Twin.uid(twin, "B")
    assert {_, :one} = twin |> Twin.rebooted() |> Twin.uid("B")
  end
end
