defmodule Aerie.Fleet.Client.Supervisor do
  @moduledoc """
  What serves programs on this machine by unix sockets. Nothing else of the gateway depends on it, so it is the last
  child of the gateway, and if it crashes, only its clients lose their connections.
  """
  use Supervisor

  alias Aerie.Fleet.Client.{Settings, StateClient, StateFeed}
  alias Aerie.Base.Names
  alias Aerie.Base.Net.UnixSocket.Listener
  alias Aerie.Fleet.Client.MavlinkSocket

  @doc "Options: `:gateway`, `:settings` (`Aerie.Fleet.Client.Settings`)."
  @spec start_link(keyword()) :: Supervisor.on_start()
  def start_link(options) do
    Supervisor.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :clients))
  end

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:clients, gateway})
    children = sockets(gateway, Keyword.fetch!(options, :settings))
    Supervisor.init(children, strategy: :one_for_one, max_restarts: 20, max_seconds: 10)
  end

  defp sockets(gateway, %Settings{enabled: true} = settings) do
    [{StateFeed, gateway: gateway, hz: settings.state_hz}] ++
      Listener.children(gateway, :state, {StateClient, gateway: gateway}, settings) ++
      Listener.children(
        gateway,
        :mavlink,
        {MavlinkSocket, gateway: gateway, sign: settings.sign},
        settings
      )
  end

  defp sockets(_gateway, %Settings{}), do: []
end
