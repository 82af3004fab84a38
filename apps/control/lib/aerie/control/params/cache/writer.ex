defmodule Aerie.Control.Params.Cache.Writer do
  @moduledoc """
  Stores parameter lists on disk (`Aerie.Control.Params.Cache`), so that they survive restarts. This process writes the files; readers read the
  files directly. Without this process every list is read from the vehicle.
  """
  use GenServer

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.Params.{Cache, Table}
  alias Aerie.Control.Params.Cache.Settings

  require Logger

  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: GenServer.on_start()
  def start_link(options),
    do: GenServer.start_link(__MODULE__, options, name: Names.via(options[:gateway], :params_cache))

  @doc "The list that was last read from a vehicle, or nil. Only the vehicle can tell whether it is still right."
  @spec stored(Names.gateway(), snapshot :: map()) :: Table.t() | nil
  def stored(gateway, snapshot) do
    with dir when dir != nil <- Names.value(gateway, :params_cache),
         {:ok, table} <- Cache.load(dir, key(snapshot)) do
      table
    else
      _none -> nil
    end
  end

  @doc "Stores a list that was read from a vehicle."
  @spec keep(Names.gateway(), snapshot :: map(), Table.t()) :: :ok
  def keep(gateway, snapshot, table),
    do: GenServer.cast(Names.via(gateway, :params_cache), {:keep, key(snapshot), table})

  defp key(%{uid: uid}) when is_binary(uid), do: {:uid, uid}
  defp key(%{key: {network, system}}), do: {:system, network, system}

  @impl GenServer
  def init(gateway: gateway, settings: settings) do
    Process.set_label({:params_cache, gateway})
    dir = Path.expand(settings.dir)
    Names.put_value(gateway, :params_cache, dir)
    {:ok, %{gateway: gateway, dir: dir, max: settings.max_lists, failing?: false}}
  end

  @impl GenServer
  def handle_cast({:keep, key, table}, state) do
    case Cache.store(state.dir, key, table, state.max) do
      :ok -> {:noreply, %{state | failing?: false}}
      {:error, reason} -> {:noreply, failed(state, reason)}
    end
  end

  defp failed(state, reason) do
    Store.count(state.gateway, {:params, :not_kept})

    if not state.failing? do
      text = :file.format_error(reason)

      Logger.warning(
        "parameters: #{state.dir} cannot be written (#{text}); lists are read from the vehicles again"
      )
    end

    %{state | failing?: true}
  end
end
