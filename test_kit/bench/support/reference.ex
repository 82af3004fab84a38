defmodule Bench.Reference do
  @moduledoc """
  A fixed piece of work, as the gateway does: bytes are matched, maps updated, terms copied into a table, lists
  sorted. Benchmarks divide by its time, so that figures of machines of another pace can be compared. Changing it
  makes all kept figures worthless.
  """

  @rounds 200
  @tries 7

  @doc "The time of one round in microseconds: the best of some tries."
  @spec us() :: float()
  def us do
    table = :ets.new(:reference, [:set, :public])
    bytes = for n <- 1..512, into: <<>>, do: <<rem(n * 37, 251)>>
    best = 1..@tries |> Enum.map(fn _try -> try_us(bytes, table) end) |> Enum.min()
    :ets.delete(table)
    best / @rounds
  end

  defp try_us(bytes, table) do
    {us, _done} = :timer.tc(fn -> for n <- 1..@rounds, do: round(bytes, table, n) end)
    us
  end

  defp round(bytes, table, n) do
    sums = sum(bytes, %{}, 0)
    :ets.insert(table, {rem(n, 16), sums})
    [{_key, copy}] = :ets.lookup(table, rem(n, 16))
    copy |> Enum.sort_by(fn {key, value} -> {value, key} end) |> length()
  end

  defp sum(<<value::little-16, rest::binary>>, sums, crc) do
    crc = Bitwise.bxor(Bitwise.bsl(Bitwise.band(crc, 0xFFFF), 1), value)
    sum(rest, Map.update(sums, rem(value, 24), crc, &(&1 + crc)), crc)
  end

  defp sum(<<>>, sums, _crc), do: sums
end
