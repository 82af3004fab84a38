defmodule Aerie.Control.Policy.Mavlink.Writing.Aboard do
  @moduledoc """
  The plans that vehicles have, as far as the gateway knows them: as they were last read, until anybody writes one
  (`Aerie.Control.ReadCache`), or as they were last sent whole through the gateway.

  The read cache learns from the vehicle's answers that a plan was written, which takes its time. So what writes a plan
  through the gateway says so here, at once: what was read is forgotten, and a read that began before is not taken.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.Policy.Memory.ClientHistory
  alias Protocols.Mission.Item

  @fence 1
  # For good, in microseconds.
  @kept 1_000_000_000_000_000

  @doc "A plan was sent whole: its items, or nil when the vehicle may have something else."
  @spec sent(Names.gateway(), Store.vehicle_key(), 0..2, [Item.t()] | nil) :: :ok
  def sent(gateway, key, type, items) do
    written_at = now()
    change(gateway, {key, type, :read}, fn _before -> %{items: nil, written_at: written_at} end)
    change(gateway, {key, type, :sent}, fn _before -> items && %{items: items} end)
  end

  @doc "What was sent last counts no longer: another plan is begun, or the vehicle refused it."
  @spec unsent(Names.gateway(), Store.vehicle_key(), 0..2) :: :ok
  def unsent(gateway, key, type), do: change(gateway, {key, type, :sent}, fn _before -> nil end)

  @doc """
  Takes the items that were read, beginning at `read_at` (monotonic µs); false if somebody has written a plan since.
  """
  @spec read(Names.gateway(), Store.vehicle_key(), 0..2, [Item.t()], integer()) :: boolean()
  def read(gateway, key, type, items, read_at) do
    change(gateway, {key, type, :read}, fn
      %{written_at: written_at} = newer when written_at > read_at -> newer
      before -> Map.put(before || %{written_at: read_at}, :items, items)
    end)

    known(gateway, {key, type, :read}) == items
  end

  @doc "What was read is known no longer."
  @spec forget(Names.gateway(), Store.vehicle_key(), 0..2) :: :ok
  def forget(gateway, key, type), do: change(gateway, {key, type, :read}, &(&1 && %{&1 | items: nil}))

  @doc "The items of a plan, or `:unknown`; then the gateway reads them, for the next time that they are asked for."
  @spec items(Names.gateway(), Store.vehicle_key(), 0..2) :: {:ok, [Item.t()]} | :unknown
  def items(gateway, key, type) do
    with nil <- known(gateway, {key, type, :read}),
         # A fence that a vehicle did not take would be a weaker measure.
         nil <- if(type != @fence, do: known(gateway, {key, type, :sent})) do
      pid = Names.whereis(gateway, :read_cache, key)
      _asked = if pid, do: GenServer.cast(pid, {:learn, type})

      :unknown
    else
      items -> {:ok, items}
    end
  end

  defp known(gateway, row), do: with(%{items: items} <- update(gateway, row, now(), &{:keep, &1}), do: items)

  defp change(gateway, row, fun) do
    now = now()

    _full_or_no_store =
      update(gateway, row, now, fn before ->
        value = fun.(before)
        {:put, :ok, value, if(value, do: now + @kept, else: now)}
      end)

    :ok
  end

  defp update(gateway, {key, type, source}, now, fun) do
    if match?(%{client_history: _table}, Names.held(gateway, :store)),
      do: ClientHistory.update(gateway, {{:vehicle, key}, source, type}, now, fun)
  end

  defp now, do: System.monotonic_time(:microsecond)
end
