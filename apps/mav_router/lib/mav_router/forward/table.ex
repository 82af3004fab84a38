defmodule MavRouter.Forward.Table do
  @moduledoc """
  All endpoints with the rules of their owners (`MavRouter.Forward.Table.Path`), as one value that each forwarding
  process keeps for itself, so that forwarding looks no endpoint up. When endpoints change, only those are read again
  (`refresh/2`): the cost of one does not grow with the number of the others.
  """

  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Endpoints
  alias MavRouter.Forward.Table.Path
  alias MavRouter.Endpoints.Owner
  alias MavRouter.Tables

  @enforce_keys [:generation, :own, :between, :networks]
  defstruct [:generation, :own, :between, :networks, audience: 0, paths: %{}, listeners: %{}, vehicles: %{}]

  # The vehicles of a larger network hear nothing of each other (`MavRouter.Forward.Source`).
  @crowd 32

  @typedoc """
  - `generation`: of the tables that it was read from (`MavRouter.Tables.generation/1`)
  - `own`: the gateway's own ids; `networks`: all that there are
  - `between`: what vehicles hear of each other (`router.between_vehicles`)
  - `paths`: all of them; `vehicles`: those of vehicles, by network; `listeners`: those of clients, sniffers and vehicles' other
    parts
  - `audience`: moves when vehicles' frames may have other receivers than before; one more vehicle in a crowd does not count
  """
  @type t :: %__MODULE__{
          generation: non_neg_integer,
          own: {non_neg_integer, 0..255} | nil,
          between: :all | :auto | :heartbeats | :none,
          networks: [String.t()],
          audience: non_neg_integer,
          paths: %{Endpoint.key() => Path.t()},
          listeners: %{Endpoint.key() => Path.t()},
          vehicles: %{String.t() => %{Endpoint.key() => Path.t()}}
        }

  @doc "The largest number of vehicles in a network that hear each other's heartbeats."
  @spec crowd() :: pos_integer
  def crowd, do: @crowd

  @doc "Reads the tables. An endpoint that sees all networks sees the present ones: a new one moves the generation."
  @spec read(Tables.t()) :: t
  def read(tables) do
    # The generation comes first, so that a change made meanwhile is read again.
    generation = Tables.generation(tables)
    owners = Map.new(:ets.tab2list(tables.owners))

    forwarding = %__MODULE__{
      generation: generation,
      own: Tables.setting(tables, :own, nil),
      between: Tables.setting(tables, :between_vehicles, :auto),
      networks: networks(tables, owners)
    }

    for endpoint <- Endpoints.list(tables), owner = owners[elem(endpoint.key, 0)], reduce: forwarding do
      forwarding -> add(forwarding, Path.new(endpoint, owner, forwarding.networks))
    end
  end

  @doc "Brings it up to date: unchanged, with the endpoints that changed, or read again."
  @spec refresh(t, Tables.t()) :: t
  def refresh(%__MODULE__{generation: before} = forwarding, tables) do
    case Tables.generation(tables) do
      ^before -> forwarding
      now -> refresh(forwarding, tables, Tables.changes(tables, before, now), now)
    end
  end

  defp refresh(forwarding, tables, :all, _now), do: %{read(tables) | audience: forwarding.audience + 1}

  defp refresh(forwarding, tables, keys, now) do
    keys |> Enum.reduce(forwarding, &endpoint(&2, tables, &1)) |> Map.put(:generation, now)
  end

  defp endpoint(forwarding, tables, {owner, _peer} = key) do
    before = forwarding.paths[key]

    with %Endpoint{} = endpoint <- Endpoints.get(tables, key),
         %Owner{} = owner <- Endpoints.owner(tables, owner) do
      path = Path.new(endpoint, owner, forwarding.networks)
      forwarding |> remove(before) |> add(path) |> note_audience(before, path)
    else
      nil -> forwarding |> remove(before) |> note_audience(before, nil)
    end
  end

  defp add(forwarding, %Path{key: key} = path) do
    forwarding = put_in(forwarding.paths[key], path)

    cond do
      Path.vehicle?(path) ->
        %{forwarding | vehicles: Enum.reduce(path.networks, forwarding.vehicles, &put_vehicle(&2, &1, path))}

      path.broadcasts or path.sniffer ->
        put_in(forwarding.listeners[key], path)

      true ->
        forwarding
    end
  end

  defp put_vehicle(vehicles, network, path),
    do: Map.update(vehicles, network, %{path.key => path}, &Map.put(&1, path.key, path))

  defp remove(forwarding, nil), do: forwarding

  defp remove(forwarding, %Path{key: key} = path) do
    vehicles =
      if Path.vehicle?(path),
        do: Enum.reduce(path.networks, forwarding.vehicles, &delete(&2, &1, key)),
        else: forwarding.vehicles

    %{
      forwarding
      | paths: Map.delete(forwarding.paths, key),
        listeners: Map.delete(forwarding.listeners, key),
        vehicles: vehicles
    }
  end

  defp delete(vehicles, network, key) do
    case Map.delete(vehicles[network], key) do
      none when none == %{} -> Map.delete(vehicles, network)
      others -> %{vehicles | network => others}
    end
  end

  # A change of an endpoint that hears nothing, or of one vehicle among many, changes no receivers.
  defp note_audience(%{between: between} = forwarding, before, path) do
    same? =
      between in [:auto, :none] and
        Enum.all?([before, path], &(&1 == nil or deaf?(&1) or crowd?(forwarding, &1)))

    if same?, do: forwarding, else: %{forwarding | audience: forwarding.audience + 1}
  end

  defp deaf?(path), do: not path.broadcasts and not path.sniffer

  defp crowd?(forwarding, path) do
    Path.vehicle?(path) and
      Enum.all?(path.networks, &(map_size(Map.get(forwarding.vehicles, &1, %{})) > @crowd))
  end

  # The gateway's own network first, then the others in the order in which their links came, so that a later one hides no
  # system of an earlier one.
  defp networks(tables, owners) do
    own = Tables.setting(tables, :network, MavRouter.Identity.default_network())

    theirs =
      for {_id, %Owner{side: :vehicle, networks: names}} <- owners,
          is_list(names),
          name <- names,
          name != own,
          uniq: true,
          do: name

    [own | Enum.sort_by(theirs, &{Tables.setting(tables, {:network, &1}, :last), &1})]
  end
end
