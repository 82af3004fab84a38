defmodule Aerie.Control.Policy.Memory.ClientHistoryTest do
  use ExUnit.Case, async: true

  alias Aerie.Base.Store
  alias Aerie.Control.Policy.Memory.ClientHistory

  setup do
    gateway = make_ref()
    start_supervised!({Store, gateway: gateway, tables: [ClientHistory.table()]})
    {:ok, gateway: gateway}
  end

  defp put(gateway, key, now, until),
    do: ClientHistory.update(gateway, key, now, fn _before -> {:put, :ok, :value, until} end)

  defp read(gateway, key, now), do: ClientHistory.update(gateway, key, now, &{:keep, &1})

  test "a value counts until its time", %{gateway: gateway} do
    key = {"ws-1", :rate, "VID-001"}
    assert read(gateway, key, 0) == nil
    assert put(gateway, key, 0, 10) == :ok
    assert read(gateway, key, 9) == :value
    assert read(gateway, key, 10) == nil
    assert put(gateway, key, 10, 20) == :ok
    assert read(gateway, key, 19) == :value
  end

  test "of changes at the same time none is lost", %{gateway: gateway} do
    add = fn before -> {:put, :ok, (before || 0) + 1, 1} end
    change = fn _n -> for(_ <- 1..200, do: :ok = ClientHistory.update(gateway, {"a", :rate, "v"}, 0, add)) end
    1..8 |> Task.async_stream(change, timeout: :infinity) |> Stream.run()
    assert read(gateway, {"a", :rate, "v"}, 0) == 1_600
  end

  test "an owner that fills its room takes none of another's, and has room again when its rows are over", %{
    gateway: gateway
  } do
    now = System.monotonic_time(:microsecond)
    later = now + 10_000_000
    for n <- 1..3_999, do: :ok = put(gateway, {"flood", :rate, n}, now, later)
    for n <- 4_000..4_010, do: _ = put(gateway, {"flood", :rate, n}, now, later)
    assert put(gateway, {"flood", :rate, :one_more}, now, later) == :full
    # What is there can be changed, and others have room.
    assert put(gateway, {"flood", :rate, 1}, now, later) == :ok
    assert put(gateway, {"other", :rate, 1}, now, later) == :ok
    assert put(gateway, {"flood", :rate, :one_more}, later + 1, later + 2) == :ok
    assert read(gateway, {"flood", :rate, 1}, later + 1) == nil
  end

  test "many owners together have room for a bounded number, and each for what is reserved for it", %{
    gateway: gateway
  } do
    now = System.monotonic_time(:microsecond)

    results =
      for owner <- 1..7, n <- 1..3_900, do: {owner, put(gateway, {owner, :rate, n}, now, now + 10_000_000)}

    stored = for {owner, :ok} <- results, do: owner
    # Five had all they asked for, the sixth what was left, the last what is kept for it.
    assert length(stored) in 20_000..20_501
    assert Enum.count(stored, &(&1 == 7)) == 500
  end

  test "what one kind of rows fills is not missing for another", %{gateway: gateway} do
    now = System.monotonic_time(:microsecond)
    for n <- 1..4_100, do: _ = put(gateway, {"viewer", :told, n}, now, now + 10_000_000)
    assert put(gateway, {"viewer", :told, :more}, now, now + 10_000_000) == :full
    assert put(gateway, {"viewer", :upload, 1}, now, now + 10_000_000) == :ok
  end
end
