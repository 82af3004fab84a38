defmodule Aerie.Control.Policy.ControlLease.Holders do
  @moduledoc """
  The leases of a gateway: who is in charge of each vehicle. A table of the store, which any process reads and changes
  without waiting for another. Subscribers of `:leases` (`Aerie.Base.PubSub`) get `{vehicle_key, lease}` of each change,
  nil for nobody in charge.

  The table ends with the gateway: after its restart nobody is in charge.
  """

  alias Aerie.Base.{Names, Store}
  alias MavRouter.Router
  alias Aerie.Control.Policy.{Intent, ControlLease, Roles}
  alias Aerie.Base.PubSub
  alias Aerie.Vehicle.Command.Refusal

  @typedoc "A vehicle by its network and system id."
  @type vehicle :: Store.vehicle_key()

  @doc "The table that the store owns for this module."
  @spec table() :: Store.table()
  def table, do: {:leases, [:set, read_concurrency: true], []}

  @doc """
  The lease of a vehicle; nil if nobody is in charge. A program that is gone cannot hand over, so anybody who may fly
  may take it then.
  """
  @spec of(Names.gateway(), Store.vehicle_key()) :: ControlLease.t() | nil
  def of(gateway, key) do
    case row(gateway, key) do
      %ControlLease{endpoint: endpoint} = lease when endpoint != nil ->
        if Router.connected?(gateway, endpoint), do: lease, else: %{lease | offered_to: :anyone}

      lease ->
        lease
    end
  end

  @doc "Whether a source may steer a vehicle with MSP: see `Aerie.Control.Policy.ControlLease.Steering`."
  @spec steer(Names.gateway(), map() | nil, Intent.t(), Roles.source(), hold_us :: non_neg_integer()) ::
          :allow | Refusal.denial()
  defdelegate steer(gateway, snapshot, facts, source, hold_us \\ 0), to: ControlLease.Steering, as: :claim

  defp row(gateway, key),
    do: Store.with_table(gateway, :leases, nil, &:ets.lookup_element(&1, key, 2, nil))

  @doc "All vehicles that somebody is in charge of."
  @spec all(Names.gateway()) :: %{Store.vehicle_key() => ControlLease.t()}
  def all(gateway), do: Map.new(Store.with_table(gateway, :leases, [], &:ets.tab2list/1))

  @doc """
  Changes who is in charge (`Aerie.Control.Policy.ControlLease.change/6`). If several take it at once, one succeeds;
  nobody can be in charge of a vehicle that was not heard yet (nil).
  """
  @spec change(
          Names.gateway(),
          Store.vehicle_key() | nil,
          ControlLease.change(),
          Roles.source(),
          String.t(),
          ControlLease.rules()
        ) ::
          {:ok, ControlLease.t() | nil} | Refusal.denial()
  def change(_gateway, nil, _change, _source, _via, _rules), do: Refusal.deny(:unheard)

  def change(gateway, key, change, source, via, rules) do
    before = row(gateway, key)

    with {:ok, lease} <-
           ControlLease.change(of(gateway, key), change, source, via, rules, System.os_time(:microsecond)) do
      cond do
        lease == before ->
          {:ok, lease}

        swap(Store.table!(gateway, :leases), key, before, lease) ->
          PubSub.publish(gateway, :leases, {key, lease})
          {:ok, lease}

        # Somebody else was faster: what they did counts.
        true ->
          change(gateway, key, change, source, via, rules)
      end
    end
  end

  defp swap(table, key, nil, lease), do: :ets.insert_new(table, {key, lease})

  defp swap(table, key, before, nil),
    do: :ets.select_delete(table, [{{key, :"$1"}, [{:"=:=", :"$1", {:const, before}}], [true]}]) == 1

  defp swap(table, key, before, lease) do
    row = {{{:const, key}, {:const, lease}}}
    :ets.select_replace(table, [{{key, :"$1"}, [{:"=:=", :"$1", {:const, before}}], [row]}]) == 1
  end
end
