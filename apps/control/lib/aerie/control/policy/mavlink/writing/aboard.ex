defmodule Aerie.Control.Policy.Mavlink.Writing.Aboard do
  @moduledoc """
  The plans that vehicles have, as far as the gateway knows them: as they were last read, until anybody writes one
  (`Aerie.Control.ReadCache`), or as they were last sent whole through the gateway.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.Policy.Memory.ClientHistory
  alias Protocols.Mission.Item

  @fence 1
  # For good, in microseconds.
  @kept 1_000_000_000_000_000

  @type source :: :read | :sent

  @doc "Remembers the items of a plan; nil forgets them."
  @spec put(Names.gateway(), Store.vehicle_key(), 0..2, source(), [Item.t()] | nil) :: :ok
  def put(gateway, key, type, source, items) do
    now = System.monotonic_time(:microsecond)
    until = if items, do: now + @kept, else: now
    _full = update(gateway, {key, type, source}, now, fn _before -> {:put, :ok, items, until} end)
    :ok
  end

  @doc "The items of a plan, or `:unknown`; then the gateway reads them, for the next time that they are asked for."
  @spec items(Names.gateway(), Store.vehicle_key(), 0..2) :: {:ok, [Item.t()]} | :unknown
  def items(gateway, key, type) do
    with nil <- known(gateway, key, type, :read),
         # A fence that a vehicle did not take would be a weaker measure.
         nil <- if(type != @fence, do: known(gateway, key, type, :sent)) do
      pid = Names.whereis(gateway, :read_cache, key)
      _asked = if pid, do: GenServer.cast(pid, {:learn, type})

      :unknown
    else
      items -> {:ok, items}
    end
  end

  defp known(gateway, key, type, source) do
    update(gateway, {key, type, source}, System.monotonic_time(:microsecond), &{:keep, &1})
  end

  defp update(gateway, {key, type, source}, now, change) do
    if match?(%{client_history: _table}, Names.held(gateway, :store)),
      do: ClientHistory.update(gateway, {{:vehicle, key}, source, type}, now, change)
  end
end
