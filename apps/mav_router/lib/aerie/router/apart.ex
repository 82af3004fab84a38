defmodule Aerie.Router.Apart do
  @moduledoc """
  By which endpoints another vehicle is heard that uses the system id of one that was there before: told by that vehicle's
  session (`Aerie.Vehicle.Rivals`), looked at by whoever forwards.

  What comes by such an endpoint from that system goes to its session, which watches it, and to sniffers, and nowhere else
  (`collided` in its counters). It is no way to the system, and nothing that it brings is a duplicate.

  Telemetry: `[:aerie, :router, :collision]` with `gateway`, `network`, `system`, `links` (words), when it is told first and
  when it is over (no links).
  """

  alias Aerie.Names
  alias Aerie.Router.Routes
  alias Aerie.Router.Tables

  @typedoc "A link's id, or that with one of its peers where several bring the system."
  @type way :: term

  @doc "These ways are another vehicle's; a link's id stands for all of its endpoints. None: there is one vehicle."
  @spec put(Names.gateway(), {String.t(), non_neg_integer}, [way]) :: :ok
  def put(gateway, {network, system} = key, ways) do
    with tables when is_map(tables) <- Tables.of(gateway),
         before when before != ways <- ways(tables, key) do
      if ways == [],
        do: :ets.delete(tables.settings, {:apart, key}),
        else: :ets.insert(tables.settings, {{:apart, key}, ways})

      for way <- ways, do: forget(tables, key, way)
      Tables.rerouted(tables)
      metadata = %{gateway: gateway, network: network, system: system, links: Enum.map(ways, &text/1)}
      :telemetry.execute([:aerie, :router, :collision], %{}, metadata)
    end

    :ok
  end

  defp forget(tables, key, {link, peer}), do: Routes.forget_system(tables, key, link, peer)
  defp forget(tables, key, link), do: Routes.forget_system(tables, key, link, :_)

  @doc "Whether what an endpoint brings of a system is another vehicle's."
  @spec other?(Tables.t(), {String.t(), non_neg_integer}, Routes.way()) :: boolean
  def other?(tables, key, {link, _peer} = way) do
    case ways(tables, key) do
      [] -> false
      ways -> way in ways or link in ways
    end
  end

  @doc "A way in words: its link, with the peer where that is an address."
  @spec text(way) :: String.t()
  def text({link, {address, port}}) when is_tuple(address) and is_integer(port),
    do: "#{link} (#{Aerie.Address.format(address, port)})"

  def text({link, _peer}), do: to_string(link)
  def text(link), do: to_string(link)

  defp ways(tables, key), do: :ets.lookup_element(tables.settings, {:apart, key}, 2, [])
end
