defmodule Aerie.CLI.Output.LogKeeper do
  @moduledoc """
  Sends the log to a device, and keeps it going: Erlang's logger removes a handler whose process has died, and nothing would be
  logged any more. Looks once a second, and adds the handler as it was last.
  """
  use GenServer

  @every_ms 1_000
  @handler :default

  @spec start_link(term()) :: GenServer.on_start()
  def start_link(_options), do: GenServer.start_link(__MODULE__, nil, name: __MODULE__)

  @doc "Sends the log to a device instead of the BEAM's standard output."
  @spec take(atom()) :: :ok
  def take(device), do: GenServer.call(__MODULE__, {:take, device})

  # A keeper that was restarted finds the handler.
  @impl GenServer
  def init(nil) do
    Process.set_label(:log_keeper)
    {:ok, _timer} = :timer.send_interval(@every_ms, :look)

    {:ok,
     with(%{config: %{type: {:device, _name}}} = handler <- current(), do: handler, else: (_other -> nil))}
  end

  @impl GenServer
  def handle_call({:take, device}, _from, _handler) do
    # The BEAM's own may have ended with its device.
    handler = current() || %{module: :logger_std_h}
    _ = :logger.remove_handler(@handler)

    handler =
      Map.merge(handler, %{config: %{type: {:device, device}}, formatter: Aerie.Base.Log.Formatter.new()})

    {:reply, :logger.add_handler(@handler, :logger_std_h, handler), handler}
  end

  @impl GenServer
  def handle_info(:look, nil), do: {:noreply, nil}
  def handle_info(:look, handler), do: {:noreply, current() || again(handler)}
  def handle_info(_other, handler), do: {:noreply, handler}

  defp again(handler) do
    # The numbers in its configuration are those of the one that died.
    handler = Map.update!(handler, :config, &Map.take(&1, [:type]))
    _ = :logger.add_handler(@handler, :logger_std_h, handler)
    handler
  end

  defp current,
    do: with({:ok, handler} <- :logger.get_handler_config(@handler), do: handler, else: (_none -> nil))
end
