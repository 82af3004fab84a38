defmodule Aerie.SerialPeer do
  @moduledoc """
  The other end of a serial cable, over a PTY, as a device with a baud rate of its own: what it says to a port that is set
  to another rate arrives as a real receiver would read it (`MavCodec.Test.BaudModel`).

  It speaks by itself, `every` so many milliseconds what `says` gives for the number of the turn, and can be unplugged,
  plugged in as another device, paused and flooded with. The PTY's master is held by the small program of circuits_uart's
  own tests.
  """
  use GenServer

  alias MavCodec.Test.BaudModel

  @source Path.expand("../../../../packages/circuits_uart/test/support/pty_peer.c", __DIR__)

  @doc "Builds the program; false without a C compiler."
  @spec build() :: boolean
  def build do
    cc = System.find_executable("cc") || System.find_executable("gcc")
    cc != nil and match?({_, 0}, System.cmd(cc, ["-O2", "-o", program(), @source], stderr_to_stdout: true))
  end

  defp program, do: Path.join(Mix.Project.app_path(), "pty_peer")

  @doc """
  Starts one, plugged in. Options: `:baud` (57,600; `:any` for USB, where rates mean nothing), `:every` ms, `:says` (turn
  number to bytes), `:to` (a process that gets `{:heard, peer, bytes}`), `:name_in` (`{folder, name}`: a symbolic link to it
  is kept there while it is plugged in).
  """
  @spec start(keyword) :: pid
  def start(options \\ []) do
    ExUnit.Callbacks.start_supervised!(%{
      id: make_ref(),
      start: {GenServer, :start_link, [__MODULE__, options]},
      restart: :temporary
    })
  end

  @doc "The device that it is now."
  @spec path(pid) :: String.t()
  def path(peer), do: GenServer.call(peer, :path, Aerie.Patience.ms())

  @doc "Pulls the cable."
  @spec unplug(pid) :: :ok
  def unplug(peer), do: GenServer.call(peer, :unplug, Aerie.Patience.ms())

  @doc "Plugs it in again, as another device; gives its path."
  @spec plug_in(pid, keyword) :: String.t()
  def plug_in(peer, options \\ []), do: GenServer.call(peer, {:plug_in, options}, Aerie.Patience.ms())

  @doc "Changes what it does: `:baud`, `:every`, `:says`."
  @spec change(pid, keyword) :: :ok
  def change(peer, options), do: GenServer.call(peer, {:change, options}, Aerie.Patience.ms())

  @doc "Says something now."
  @spec say(pid, binary) :: :ok
  def say(peer, bytes), do: GenServer.call(peer, {:say, bytes}, Aerie.Patience.ms())

  @doc "How often it has spoken."
  @spec turns(pid) :: non_neg_integer
  def turns(peer), do: GenServer.call(peer, :turns, Aerie.Patience.ms())

  @impl GenServer
  def init(options) do
    port = Port.open({:spawn_executable, program()}, [:binary, packet: 2])
    state = Map.merge(%{baud: 57_600, every: nil, says: nil, to: nil, name_in: nil}, Map.new(options))
    state = Map.merge(state, %{port: port, path: await(port, ?n), turn: 0, timer: nil, heard: []})
    {:ok, state |> link() |> schedule()}
  end

  @impl GenServer
  def handle_call(:path, _from, state), do: {:reply, state.path, state}
  def handle_call(:turns, _from, state), do: {:reply, state.turn, state}
  def handle_call(:unplug, _from, %{path: nil} = state), do: {:reply, :ok, state}

  def handle_call(:unplug, _from, state) do
    unlink(state)
    command(state, "x")
    {:reply, :ok, %{state | path: after_heard(state, ?x) && nil}}
  end

  def handle_call({:plug_in, options}, _from, state) do
    state = Map.merge(state, Map.new(options))
    command(state, "o")
    state = link(%{state | path: after_heard(state, ?n)})
    {:reply, state.path, schedule(state)}
  end

  def handle_call({:change, options}, _from, state) do
    {:reply, :ok, state |> Map.merge(Map.new(options)) |> schedule()}
  end

  def handle_call({:say, bytes}, _from, state), do: {:reply, :ok, speak(state, bytes)}

  @impl GenServer
  def handle_info(:turn, state) do
    state = if state.path, do: speak(state, state.says.(state.turn)), else: state
    {:noreply, schedule(%{state | turn: state.turn + 1})}
  end

  def handle_info({port, {:data, <<?d, bytes::binary>>}}, %{port: port} = state) do
    heard(state, bytes)
    {:noreply, state}
  end

  @impl GenServer
  def terminate(_reason, state), do: unlink(state)

  defp heard(%{to: nil}, _bytes), do: :ok
  defp heard(%{to: to}, bytes), do: send(to, {:heard, self(), bytes})

  defp schedule(state) do
    if state.timer, do: Process.cancel_timer(state.timer)
    timer = if state.every, do: Process.send_after(self(), :turn, state.every)
    %{state | timer: timer}
  end

  defp speak(%{path: nil} = state, _bytes), do: state

  defp speak(%{baud: baud} = state, bytes) do
    command(state, "t")

    case after_heard(state, ?t) do
      # As a line that nobody has opened yet: a PTY would echo it, a serial port does not even receive it.
      <<_cflag::32, _iflag::32, lflag::32, _rest::binary>> when lflag != 0 ->
        state

      _settings when baud == :any ->
        write(state, "w", bytes)

      <<_flags::96, ^baud::32, _rest::binary>> ->
        write(state, ["s", <<baud::32>>], bytes)

      <<_flags::96, speed::32, _rest::binary>> ->
        write(state, ["s", <<speed::32>>], BaudModel.receive(bytes, baud, speed))
    end
  end

  # What was meant for one rate must not arrive at the next one, however late a busy machine writes it.
  defp write(state, how, bytes) when byte_size(bytes) > 8_000 do
    <<piece::binary-size(8_000), rest::binary>> = bytes
    state |> write(how, piece) |> write(how, rest)
  end

  defp write(state, _how, ""), do: state

  defp write(state, how, bytes) do
    command(state, [how, bytes])
    state
  end

  defp command(state, packet), do: Port.command(state.port, packet)

  # Answers come in order with what is heard.
  defp after_heard(%{port: port} = state, letter) do
    receive do
      {^port, {:data, <<^letter, rest::binary>>}} ->
        rest

      {^port, {:data, <<?d, bytes::binary>>}} ->
        heard(state, bytes)
        after_heard(state, letter)
    after
      Aerie.Patience.ms() -> raise "the cable's other end did not answer #{<<letter>>}"
    end
  end

  defp await(port, letter) do
    receive do
      {^port, {:data, <<^letter, rest::binary>>}} -> rest
    after
      Aerie.Patience.ms() -> raise "the cable's other end did not start"
    end
  end

  defp link(%{name_in: nil} = state), do: state

  defp link(%{name_in: {folder, name}} = state) do
    File.mkdir_p!(folder)
    _ = File.rm(Path.join(folder, name))
    File.ln_s!(state.path, Path.join(folder, name))
    state
  end

  defp unlink(%{name_in: nil}), do: :ok
  defp unlink(%{name_in: {folder, name}}), do: File.rm(Path.join(folder, name))
end
