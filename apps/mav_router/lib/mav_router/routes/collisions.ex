defmodule MavRouter.Routes.Collisions do
  @moduledoc """
  The endpoints by which another vehicle is heard that uses the system id of one that was there before. The session of the
  vehicle finds out and says so; every forwarding process looks.

  Frames of that system which come by such an endpoint go to the session, which watches them, and to sniffers, and nowhere else
  (`collided` in the endpoint's counters). No route leads there, and the frames are never taken for duplicates.

  Telemetry: `[:aerie, :router, :collision]` with `gateway`, `network`, `system`, `links` (for people), when a collision begins
  or changes, and without links when it is over.
  """

  alias Aerie.Base.Names
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Routes
  alias MavRouter.Tables

  @typedoc "An endpoint's key, or a link's id for all of its endpoints."
  @type by :: Endpoint.key() | String.t()

  @doc "Says which endpoints bring another vehicle; with none the collision is over."
  @spec put(Names.gateway(), {String.t(), non_neg_integer}, [by]) :: :ok
  def put(gateway, {network, system} = key, collided) do
    with tables when is_map(tables) <- Tables.of(gateway),
         before when before != collided <- collided(tables, key) do
      if collided == [],
        do: :ets.delete(tables.settings, {:collision, key}),
        else: :ets.insert(tables.settings, {{:collision, key}, collided})

      for by <- collided, do: forget(tables, key, by)
      Tables.rerouted(tables)
      metadata = %{gateway: gateway, network: network, system: system, links: Enum.map(collided, &text/1)}
      :telemetry.execute([:aerie, :router, :collision], %{}, metadata)
    end

    :ok
  end

  defp forget(tables, key, {link, peer}), do: Routes.forget_system(tables, key, link, peer)
  defp forget(tables, key, link), do: Routes.forget_system(tables, key, link, :_)

  @doc "Whether the frames of a system that an endpoint brings are another vehicle's."
  @spec other?(Tables.t(), {String.t(), non_neg_integer}, Endpoint.key()) :: boolean
  def other?(tables, key, {link, _peer} = endpoint) do
    case collided(tables, key) do
      [] -> false
      collided -> endpoint in collided or link in collided
    end
  end

  @doc "The link for people, with the peer where that is an address."
  @spec text(by) :: String.t()
  def text({link, {address, port}}) when is_tuple(address) and is_integer(port),
    do: "#{link} (#{Aerie.Base.Net.Address.format(address, port)})"

  def text({link, _peer}), do: to_string(link)
  def text(link), do: to_string(link)

  defp collided(tables, key), do: :ets.lookup_element(tables.settings, {:collision, key}, 2, [])
end
