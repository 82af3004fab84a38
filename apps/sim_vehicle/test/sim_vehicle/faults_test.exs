defmodule SimVehicle.FaultsTest do
  use ExUnit.Case, async: true

  alias SimVehicle.Link.Faults

  @frames for n <- 1..4000, do: <<n::32, "frame"::binary>>

  defp set(faults, name, value, direction \\ :out) do
    {:ok, faults} = Faults.set(faults, name, value, direction)
    faults
  end

  defp pass_all(faults, frames \\ @frames, direction \\ :out) do
    Enum.flat_map_reduce(frames, faults, &Faults.pass(&2, direction, &1))
  end

  defp bytes(deliveries), do: Enum.map(deliveries, &elem(&1, 1))

  test "a perfect link changes nothing" do
    {out, faults} = pass_all(Faults.new(1))
    assert bytes(out) == @frames
    assert faults.counts.out == %{offered: 4000, passed: 4000}
  end

  test "loss drops its share and nothing else" do
    {out, faults} = pass_all(set(Faults.new(1), :loss, 0.25))
    assert_in_delta length(out), 3000, 100
    assert faults.counts.out.lost + faults.counts.out.passed == 4000
    passed = MapSet.new(bytes(out))
    assert bytes(out) == Enum.filter(@frames, &(&1 in passed))
  end

  test "duplication sends copies right behind" do
    {out, faults} = pass_all(set(Faults.new(1), :duplicate, 0.1))
    assert length(out) == 4000 + faults.counts.out.duplicated
    assert_in_delta faults.counts.out.duplicated, 400, 80
    assert Enum.dedup(bytes(out)) == @frames
  end

  test "reordering swaps with the next, loses nothing" do
    {out, faults} = pass_all(set(Faults.new(1), :reorder, 0.1))
    assert faults.counts.out.reordered > 200
    out = bytes(out)
    assert out != @frames
    assert length(@frames -- out) <= 1
    places = out |> Enum.with_index() |> Map.new()

    assert Enum.all?(Enum.with_index(@frames), fn {frame, at} -> abs(Map.get(places, frame, at) - at) <= 1 end)
  end

  test "corruption turns one bit over" do
    {out, faults} = pass_all(set(Faults.new(1), :corrupt, 0.1))
    changed = for {sent, got} <- Enum.zip(@frames, bytes(out)), sent != got, do: {sent, got}
    assert length(changed) == faults.counts.out.corrupted

    assert Enum.all?(changed, fn {sent, got} ->
             for(<<bit::1 <- :crypto.exor(sent, got)>>, do: bit) |> Enum.sum() == 1
           end)
  end

  test "delay adds its time and up to the jitter" do
    {out, _faults} = pass_all(set(Faults.new(1), :delay, {100, 50}))
    delays = Enum.map(out, &elem(&1, 0))
    assert Enum.min(delays) == 100
    assert Enum.max(delays) == 150
    assert {[{30, "x"}], _faults} = Faults.pass(set(Faults.new(1), :delay, 30), :out, "x")
  end

  test "what is held back is bounded" do
    faults = Faults.new(1) |> set(:delay, 100) |> Faults.pending(2000)
    assert {[], faults} = Faults.pass(faults, :out, "x")
    assert faults.counts.out.overflow == 1
  end

  test "silence, deafness and a half-open connection" do
    silent = set(Faults.new(1), :silence, true)
    assert {[], _faults} = Faults.pass(silent, :out, "x")
    assert {[{0, "x"}], _faults} = Faults.pass(silent, :in, "x")
    deaf = set(Faults.new(1), :deaf, true)
    assert {[{0, "x"}], _faults} = Faults.pass(deaf, :out, "x")
    assert {[], _faults} = Faults.pass(deaf, :in, "x")
    open = set(Faults.new(1), :half_open, true)
    assert {[], _faults} = Faults.pass(open, :out, "x")
    assert {[], faults} = Faults.pass(open, :in, "x")
    assert {[{0, "x"}], _faults} = Faults.pass(set(faults, :half_open, false), :in, "x")
  end

  test "directions do not touch each other" do
    {out, _faults} = pass_all(set(Faults.new(1), :loss, 1.0, :in))
    assert length(out) == 4000
    assert {[], _faults} = pass_all(set(Faults.new(1), :loss, 1.0, :in), @frames, :in)
  end

  test "the same seed gives the same faults" do
    faults = fn seed -> Faults.new(seed) |> set(:loss, 0.1) |> set(:corrupt, 0.1) |> set(:duplicate, 0.1) end
    {first, _faults} = pass_all(faults.(5))
    {second, _faults} = pass_all(faults.(5))
    {other, _faults} = pass_all(faults.(6))
    assert first == second
    assert first != other
  end

  test "an unknown fault, or a wrong value, is refused with a text" do
    assert {:error, "expected a fault of" <> _rest} = Faults.set(Faults.new(1), :fire, 1, :out)
    assert {:error, _text} = Faults.set(Faults.new(1), :loss, 1.5, :out)
    assert {:error, _text} = Faults.set(Faults.new(1), :delay, -1, :out)
    assert {:error, _text} = Faults.set(Faults.new(1), :silence, 3, :out)
  end
end
