defmodule MavRouter.Identity do
  @moduledoc """
  The gateway's own ids on MAVLink, and whether it is well enough to send its heartbeat.

  An id that the configuration leaves open (`mavlink.system_id: auto`) is found out by `MavRouter.Router.AutoSystemId` and kept in the
  store; `resolve/2` puts it into the settings.
  """

  alias MavRouter.Identity.{Settings, Watchdog}
  alias Aerie.Base.Names
  alias Aerie.Base.Store

  # The system id of a hub: among those of ground stations (R10), but not one of a common tool. 255 is that of QGroundControl, Mission
  # Planner, MAVProxy, pymavlink and DroneKit, 254 of node-mavlink and Skybrush, 252 of APM Planner, 245 of MAVSDK.
  @hub 237
  @component 191
  @note {:identity, :system}

  @doc "The gateway's own ids if the configuration gives none: `{system, component}`."
  @spec default_ids() :: {pos_integer, 1..255}
  def default_ids, do: {@hub, @component}

  @doc "The network of whatever names none."
  @spec default_network() :: String.t()
  def default_network, do: "main"

  @doc "Settings whose `auto` is replaced by the system id that was found out; it stays `:auto` until then."
  @spec resolve(Settings.t(), Names.gateway()) :: Settings.t()
  def resolve(%Settings{system_id: :auto} = settings, gateway),
    do: %{settings | system_id: Store.recall(gateway, @note, :auto)}

  def resolve(%Settings{} = settings, _gateway), do: settings

  @doc "The gateway's own ids, `:auto` for a system id that is not known yet."
  @spec ids(Settings.t(), Names.gateway()) :: {pos_integer | :auto, 1..255}
  def ids(settings, gateway) do
    %Settings{system_id: system, component_id: component} = resolve(settings, gateway)
    {system, component}
  end

  @doc "Keeps the system id that was found out, until the gateway ends."
  @spec remember(Names.gateway(), pos_integer) :: :ok
  def remember(gateway, system), do: Store.remember(gateway, @note, system)

  @doc """
  Whether the gateway's processes answer: `%{alive: boolean, silent: [{role, id}], deadman_ms: ms}`, where `silent` are those that have
  not answered in time. Without the process that asks them nothing is alive.
  """
  @spec status(Names.gateway()) :: %{
          alive: boolean(),
          silent: [{atom(), term()}],
          deadman_ms: pos_integer() | nil
        }
  defdelegate status(gateway), to: Watchdog
end
