defmodule Aerie.Control.Params.Metadata.EventDefinitions do
  @moduledoc """
  Reads what a vehicle says about its events, when its session sends `:read`, and sends the session
  `{:event_definitions, definitions}`: what is otherwise than in Aerie's own file
  (`Aerie.Vehicle.Services.Reports.Definitions`). `Aerie.Gateway` plugs it into the vehicles' trees.

  The session asks once per boot. Without an answer, or with a file that cannot be read, Aerie's own file applies to
  all events; a line in the log says why. The reading is a process of its own, so that its death concerns nobody else.
  """
  use GenServer

  alias Aerie.Base.Names
  alias Aerie.Control.Params.Metadata.Reader
  alias Aerie.Vehicle.Services.Reports

  require Logger

  @spec start_link(gateway: Names.gateway(), options: Aerie.Vehicle.Options.t()) :: GenServer.on_start()
  def start_link(arguments) do
    name = Names.via(arguments[:gateway], :event_definitions, arguments[:options].key)
    GenServer.start_link(__MODULE__, arguments, name: name)
  end

  @impl GenServer
  def init(gateway: gateway, options: options) do
    Process.set_label({:event_definitions, options.id})
    {:ok, %{gateway: gateway, id: options.id, key: options.key, reading: nil}}
  end

  @impl GenServer
  def handle_info(:read, %{reading: nil} = state) do
    {_pid, monitor} = spawn_monitor(fn -> read(state) end)
    {:noreply, %{state | reading: monitor}}
  end

  # The one under way will do.
  def handle_info(:read, state), do: {:noreply, state}

  def handle_info({:DOWN, monitor, :process, _pid, _reason}, %{reading: monitor} = state),
    do: {:noreply, %{state | reading: nil}}

  defp read(%{gateway: gateway, id: id, key: key}) do
    Process.set_label({:event_definitions_reading, id})

    definitions =
      case Reader.events(gateway, id) do
        {:ok, definitions} -> Reports.Names.own(definitions)
        {:error, result} -> refused(id, result)
      end

    with session when is_pid(session) <- Names.whereis(gateway, :session, key),
         do: send(session, {:event_definitions, definitions})
  end

  defp refused(id, result) do
    level = if result.details["rule"] == "metadata", do: :warning, else: :info

    Logger.log(
      level,
      "#{id}: Aerie's own definitions of events are used, because the vehicle's cannot be read: #{result.reason}"
    )

    Reports.Definitions.none()
  end
end
