defmodule Aerie.Router.Supervisor do
  @moduledoc """
  Owns the router's tables (`Aerie.Router.Tables`) and supervises what works on them; client endpoints join it.

  The tables live as long as this supervisor. A restart of it costs the learned routes; they are learned again with the
  next frame of each component.
  """
  use Supervisor

  alias Aerie.Names
  alias Aerie.Router.Tables
  alias Aerie.Router.AutoSystemId

  @doc """
  Options: `:gateway`, `:config`; `:vehicles` (`Aerie.Router.Vehicles`) and `:requests` (`Aerie.Router.Requests`), modules, none
  when absent; `:children`, modules that are supervised beside the router's own processes, with `:gateway` and `:config`.
  """
  @spec start_link(keyword) :: Supervisor.on_start()
  def start_link(options) do
    Supervisor.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :router))
  end

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:router, gateway})
    config = Keyword.get(options, :config)
    _tables = Tables.create(gateway, settings(config, gateway), Keyword.take(options, [:vehicles, :requests]))

    children = [
      {Aerie.Router.Watch, gateway: gateway},
      {Aerie.Router.Nursery, gateway: gateway},
      {Aerie.Router.Sweeper, gateway: gateway},
      {Aerie.Router.Meter, gateway: gateway},
      {Aerie.Router.Turns, gateway: gateway}
    ]

    further =
      for module <- Keyword.get(options, :children, []), do: {module, gateway: gateway, config: config}

    # Sweeping is not worth more than a few tries: without it the tables are still bounded.
    Supervisor.init(children ++ further, strategy: :one_for_one, max_restarts: 10, max_seconds: 10)
  end

  # Frames that carry our own ids come back through a loop.
  defp settings(config, gateway),
    do:
      AutoSystemId.settings(config, gateway) ++ [between_vehicles: between(config), network: network(config)]

  defp between(%{router: %{between_vehicles: between}}), do: between
  defp between(_none), do: :auto

  defp network(%{network: network}) when is_binary(network), do: network
  defp network(_none), do: "main"
end
