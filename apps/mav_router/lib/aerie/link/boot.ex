defmodule Aerie.Link.Boot do
  @moduledoc """
  Starts the links that there are to be: those of the configuration when the gateway starts, and after a restart of the
  links' supervisor those that ran before it (the store remembers them), links added and removed at run time included.

  It is done before anyone can ask for links, and does not wait for connections.
  """
  use GenServer, restart: :transient

  alias Aerie.Store
  alias Aerie.Link.Spec
  alias Aerie.Successor
  alias Aerie.Names

  require Logger

  @booted {:links, :booted}

  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options) do
    GenServer.start_link(__MODULE__, options, name: Names.via(Keyword.fetch!(options, :gateway), :link_boot))
  end

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:link_boot, gateway})
    Enum.each(specs(gateway, Keyword.get(options, :config)), &start(gateway, &1))
    _times = Store.count(gateway, @booted)
    :ignore
  end

  defp specs(gateway, config) do
    if Store.counter(gateway, @booted) == 0 do
      # Ids are unique in a checked configuration; a second one of an id would take the first one's place.
      config |> config_specs() |> Enum.uniq_by(& &1.id)
    else
      Enum.map(Store.links(gateway), & &1.spec)
    end
  end

  # The configuration was checked when it was loaded; a caller's own map is not worth a gateway that does not start.
  defp config_specs(%{links: links}) when is_list(links) do
    Enum.flat_map(links, fn link ->
      case Spec.parse(link.url, id: link[:id], network: link[:network], options: options(link)) do
        _any when link.enabled == false ->
          []

        {:ok, spec} ->
          [spec]

        {:error, error} ->
          Logger.error(Exception.message(error))
          []
      end
    end)
  end

  defp config_specs(_none), do: []

  defp options(link) do
    [
      label: link[:label],
      high_latency: link[:high_latency] || false,
      secure: link[:secure] || false,
      router: router(link)
    ]
  end

  defp router(link) do
    case Aerie.Router.Settings.owner_options(Map.new(link)) do
      {:ok, options} ->
        options

      {:error, words} ->
        Logger.error("link #{link[:id]}: #{words}")
        []
    end
  end

  # Links of a supervisor that was killed may be there for a moment still.
  defp start(gateway, spec) do
    case Successor.start(fn -> Aerie.Link.Supervisor.start_tree(gateway, spec: spec) end) do
      {:ok, _tree} -> :ok
      {:error, reason} -> Logger.error("link #{spec.id} not started: #{inspect(reason)}")
    end
  end
end
