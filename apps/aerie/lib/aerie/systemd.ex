defmodule Aerie.Systemd do
  @moduledoc """
  Tells systemd how the gateway is (`sd_notify(3)`): that it is ready, what it does (`systemctl status`), that it is ending, and,
  with `WatchdogSec=` in the unit, that its supervision tree is alive. systemd restarts a gateway that has stopped saying so.

  Alive means what the gateway's own heartbeat needs (`MavRouter.Identity.status/1`), and that its supervisor answers. A vehicle whose
  process is stuck does not count: a restart of everything would cost all other vehicles.

  It does nothing if no service manager started the gateway, which is when `NOTIFY_SOCKET` is not set.
  """
  use GenServer

  alias Aerie.Base.{Names, Store}
  alias MavRouter.Identity

  # Without a watchdog, how often the text for `systemctl status` is renewed.
  @status_ms 10_000
  @answer_ms 2_000

  @doc "Whether a service manager started this program: it shows its status, and the log is its journal."
  @spec there?() :: boolean()
  def there?, do: System.get_env("NOTIFY_SOCKET", "") != ""

  @doc "Tells it that another process of the service is the one to watch from now on."
  @spec main_process(pid :: String.t()) :: :ok
  def main_process(pid) do
    if there?() do
      {:ok, socket} = :gen_udp.open(0, [:local, active: false])
      notify(%{socket: socket, path: address(System.fetch_env!("NOTIFY_SOCKET"))}, "MAINPID=#{pid}\n")
      :gen_udp.close(socket)
    else
      :ok
    end
  end

  @doc "Options: `:gateway`; `:environment`, the process's own if left out."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(options), do: GenServer.start_link(__MODULE__, options)

  @impl GenServer
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    environment = Keyword.get_lazy(options, :environment, &System.get_env/0)

    case environment["NOTIFY_SOCKET"] do
      path when path in [nil, ""] ->
        :ignore

      path ->
        # So that terminate/2 is called.
        Process.flag(:trap_exit, true)
        Process.set_label({:systemd, gateway})
        {:ok, socket} = :gen_udp.open(0, [:local, active: false])

        state = %{
          gateway: gateway,
          socket: socket,
          path: address(path),
          every: every(environment["WATCHDOG_USEC"])
        }

        # The parts before this one have started.
        notify(state, "READY=1\n")
        {:ok, state, {:continue, :tell}}
    end
  end

  @impl GenServer
  def handle_continue(:tell, state), do: {:noreply, again(state)}

  @impl GenServer
  def handle_info(:tell, state), do: {:noreply, again(state)}
  def handle_info(_other, state), do: {:noreply, state}

  @impl GenServer
  def terminate(_reason, state), do: notify(state, "STOPPING=1\nSTATUS=ending\n")

  defp again(state) do
    Process.send_after(self(), :tell, state.every)
    {alive?, text} = condition(state.gateway)
    notify(state, [if(alive?, do: "WATCHDOG=1\n", else: ""), "STATUS=", text, "\n"])
    state
  end

  @doc false
  # Whether it is alive, and one line about it.
  @spec condition(Names.gateway()) :: {boolean(), String.t()}
  def condition(gateway) do
    silent =
      if answers?(gateway),
        do: for({role, nil} <- Identity.status(gateway).silent, do: role),
        else: [:supervisor]

    if silent == [] do
      online = Enum.count(Store.vehicles(gateway), &(&1.status == :online))
      up = Enum.count(Store.links(gateway), &(&1.status in [:up, :idle]))
      {true, "#{online} vehicles online, #{up} links open"}
    else
      {false, "does not answer: #{Enum.join(silent, ", ")}"}
    end
  end

  defp answers?(gateway) do
    is_list(GenServer.call(Names.via(gateway, :gateway), :which_children, @answer_ms))
  catch
    :exit, _reason -> false
  end

  # Twice as often as systemd asks for it.
  defp every(nil), do: @status_ms

  defp every(microseconds) do
    case Integer.parse(microseconds) do
      {us, ""} when us > 0 -> max(div(us, 2000), 50)
      _other -> @status_ms
    end
  end

  # A name that begins with @ is in no folder.
  defp address("@" <> name), do: <<0, name::binary>>
  defp address(path), do: path

  # A service manager that does not listen is not our fault.
  defp notify(state, text) do
    _ = :gen_udp.send(state.socket, {:local, state.path}, 0, text)
    :ok
  end
end
