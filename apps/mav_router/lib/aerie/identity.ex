defmodule Aerie.Identity do
  @moduledoc """
  Which ids the gateway has on MAVLink, and whether it is well enough to say its heartbeat.

  Ids that the configuration leaves open (`mavlink.system_id: auto`) are found out by `Aerie.Router.AutoSystemId`; what was
  found out stands in the store, and `resolve/2` puts it into a configuration.
  """

  alias Aerie.Identity.Pulse
  alias Aerie.Names
  alias Aerie.Store

  # A hub's: from the top, where ground stations are (R10), and not one that a common one has: 255 QGroundControl, Mission
  # Planner, MAVProxy, pymavlink, DroneKit; 254 node-mavlink, Skybrush; 252 APM Planner; 245 MAVSDK and what was made after
  # its example.
  @hub 237
  @component 191
  @note {:identity, :system}

  @doc "The gateway's own ids where the configuration gives none: `{system, component}`."
  @spec default_ids() :: {pos_integer, 1..255}
  def default_ids, do: {@hub, @component}

  @doc "A configuration with the system id that was found out, where it says `auto`; `:auto` as long as none was."
  @spec resolve(term, Names.gateway()) :: term
  def resolve(%{mavlink: %{system_id: :auto}} = config, gateway),
    do: put_in(config.mavlink.system_id, Store.recall(gateway, @note, :auto))

  def resolve(config, _gateway), do: config

  @doc "The ids of a configuration, `:auto` for a system id that is still to be found out."
  @spec ids(term) :: {pos_integer | :auto, 1..255}
  def ids(%{mavlink: %{system_id: system, component_id: component}}), do: {system, component}
  def ids(_none), do: default_ids()

  @doc "Keeps the system id that was found out, until the gateway ends."
  @spec remember(Names.gateway(), pos_integer) :: :ok
  def remember(gateway, system), do: Store.remember(gateway, @note, system)

  @doc """
  Whether the gateway's loops answer: `%{alive: boolean, silent: [{role, id}], deadman_ms: ms}`, `silent` being those that
  have not answered in time. Without the process that asks them nothing is alive.
  """
  @spec status(Names.gateway()) :: %{
          alive: boolean(),
          silent: [{atom(), term()}],
          deadman_ms: pos_integer() | nil
        }
  defdelegate status(gateway), to: Pulse
end
