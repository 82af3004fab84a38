defmodule MavRouter.Link.Boot do
  @moduledoc """
  Starts the links: those of the configuration when the gateway starts, and after a restart of the links' supervisor those
  that ran before it (the store remembers them, and what was added and removed at run time).

  It is done before anybody can ask for links, and does not wait for connections.
  """
  use GenServer, restart: :transient

  alias Aerie.Base.Store
  alias MavRouter.Link.Spec

  require Logger

  @booted {:links, :booted}

  @doc "Options: `:gateway`, `:links` (as `MavRouter.Link.Settings` has them), `:start` (starts a link of a gateway)."
  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options), do: GenServer.start_link(__MODULE__, options)

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    Process.set_label({:link_boot, gateway})
    start = Keyword.fetch!(options, :start)
    Enum.each(specs(gateway, Keyword.fetch!(options, :links)), &start(start, gateway, &1))
    _times = Store.count(gateway, @booted)
    :ignore
  end

  defp specs(gateway, links) do
    if Store.counter(gateway, @booted) == 0 do
      # Ids are unique in a checked configuration; a second link with the same id would replace the first.
      links |> configured() |> Enum.uniq_by(& &1.id)
    else
      Enum.map(Store.links(gateway), & &1.spec)
    end
  end

  # A loaded configuration was checked; an error in a caller's own map must not keep the gateway from starting.
  defp configured(links) do
    Enum.flat_map(links, fn
      %{enabled: false} ->
        []

      link ->
        case Spec.configured(link) do
          {:ok, spec} ->
            [spec]

          {:error, words} ->
            Logger.error("link #{link[:id]}: #{words}")
            []
        end
    end)
  end

  defp start(start, gateway, spec) do
    case start.(gateway, spec: spec) do
      {:ok, _tree} -> :ok
      {:error, reason} -> Logger.error("link #{spec.id} not started: #{inspect(reason)}")
    end
  end
end
