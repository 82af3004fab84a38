defmodule Aerie.CLI.Output do
  @moduledoc """
  An I/O device on standard output or standard error that a gateway can rely on: `IO.write(Aerie.CLI.Output.stdout(), text)`.

  The BEAM's own devices end for good at the first write that fails (a full disk, a pipe whose reader is gone) and take the
  log handler along; a terminal that is stopped, or a pipe that nobody reads, blocks the writer. Here no writer ever waits
  or fails. What cannot be written is lost and counted. Four times a second the device tries to say how many lines are
  missing; once that succeeds, it goes on.
  """
  use GenServer

  @retry_ms 250
  # How long the end of a program waits for the answer to its last write, in steps of 10 ms.
  @settle_steps 200

  @doc """
  Options: `fd` (1: standard output, 2: standard error), `name` (of the process, which is the device), `lost` (a function that
  is called with a number of lines that were lost).
  """
  @spec start_link(fd: 1 | 2, name: atom(), lost: (pos_integer() -> term())) :: GenServer.on_start()
  def start_link(options), do: GenServer.start_link(__MODULE__, options, name: options[:name])

  @doc false
  def child_spec(options), do: %{id: options[:name], start: {__MODULE__, :start_link, [options]}}

  @doc "The device for standard output."
  @spec stdout() :: atom()
  def stdout, do: :aerie_stdout

  @doc "The device for standard error."
  @spec stderr() :: atom()
  def stderr, do: :aerie_stderr

  @doc """
  Writes to standard output what the BEAM's own device did not take, which does not say why it has ended: `:closed` if the reader of a
  pipe has seen enough (`| head`), else an error for the user.
  """
  @spec repeat(iodata()) :: :ok | :closed | {:error, String.t()}
  def repeat(text) do
    with {:ok, file} <- :file.open("/dev/stdout", [:raw, :append]), :ok <- :file.write(file, text) do
      :ok
    else
      {:error, :epipe} -> :closed
      {:error, reason} -> {:error, refusal(reason)}
    end
  end

  @doc """
  What a device of this module could not write last, as an error for the user; nil if nothing is missing. Waits up to 2 s for
  what is being written.
  """
  @spec problem(atom()) :: String.t() | nil
  def problem(device) do
    case GenServer.call(device, :reason) do
      reason when reason in [nil, :epipe] -> nil
      reason -> refusal(reason)
    end
  end

  defp refusal(reason), do: "standard output takes nothing: #{describe(reason)}"

  @impl GenServer
  def handle_call(:reason, _from, state) do
    state = settle(state, @settle_steps)
    {:reply, state.reason, state}
  end

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    Process.set_label({:aerie, options[:name]})
    {:ok, %{fd: options[:fd], on_lost: options[:lost], port: nil, lost: 0, reason: nil}}
  end

  @impl GenServer
  def handle_info({:io_request, from, ref, request}, state) do
    {reply, state} = request(request, state)
    send(from, {:io_reply, ref, reply})
    {:noreply, state}
  end

  def handle_info({:EXIT, port, reason}, %{port: port} = state) when is_port(port),
    do: {:noreply, lost(%{state | port: nil}, 1, reason)}

  def handle_info(:retry, state) do
    note = "#{state.lost} lines of output are missing here: #{describe(state.reason)}\n"

    case put(state, note) do
      {:ok, state} -> {:noreply, %{state | lost: 0, reason: nil}}
      {:error, reason, state} -> {:noreply, retry(%{state | reason: reason})}
    end
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp request({:put_chars, encoding, chars}, state) do
    case :unicode.characters_to_binary(chars, encoding) do
      bytes when is_binary(bytes) -> {:ok, write(state, bytes)}
      _invalid -> {{:error, :put_chars}, state}
    end
  end

  defp request({:put_chars, encoding, module, function, arguments}, state),
    do: request({:put_chars, encoding, apply(module, function, arguments)}, state)

  defp request(:getopts, state), do: {[binary: true, encoding: :unicode], state}
  defp request(_other, state), do: {{:error, :enotsup}, state}

  # In order: nothing is written before the note on what is missing.
  defp write(%{lost: lost} = state, bytes) when lost > 0, do: lost(state, lines(bytes), state.reason)

  defp write(state, bytes) do
    case put(state, bytes) do
      {:ok, state} -> state
      {:error, reason, state} -> lost(state, lines(bytes), reason)
    end
  end

  defp lines(bytes), do: max(length(:binary.matches(bytes, "\n")), 1)

  defp put(%{port: nil, fd: fd} = state, bytes),
    do: put(%{state | port: Port.open({:fd, fd, fd}, [:out, :binary])}, bytes)

  defp put(%{port: port} = state, bytes) do
    taken = command(port, bytes)
    # Asked after the write, a port that has failed has sent its exit signal.
    _ = Port.info(port, :id)

    receive do
      {:EXIT, ^port, reason} -> {:error, reason, %{state | port: nil}}
    after
      # A closed port has sent its exit signal, or is about to.
      if(taken == :closed, do: :infinity, else: 0) ->
        if taken, do: {:ok, state}, else: {:error, :busy, state}
    end
  end

  # `nosuspend`: a port whose queue is full takes nothing, and does not stop the caller either.
  defp command(port, bytes) do
    :erlang.port_command(port, bytes, [:nosuspend])
  rescue
    # It failed before, with something that it had still queued.
    ArgumentError -> :closed
  end

  # The BEAM writes to what it cannot poll (a file, /dev/full) in a thread, and an error comes later.
  defp settle(%{port: nil} = state, _steps), do: state

  defp settle(%{port: port} = state, steps) do
    receive do
      {:EXIT, ^port, reason} -> lost(%{state | port: nil}, 1, reason)
    after
      if(steps == @settle_steps, do: 0, else: 10) ->
        case Port.info(port, :queue_size) do
          {:queue_size, 0} -> state
          # Closed: its exit signal is on the way.
          _queued when steps > 0 -> settle(state, steps - 1)
          _queued -> state
        end
    end
  end

  defp lost(state, lines, reason) do
    state.on_lost.(lines)
    state = if state.lost == 0, do: retry(state), else: state
    %{state | lost: state.lost + lines, reason: reason}
  end

  defp retry(state) do
    Process.send_after(self(), :retry, @retry_ms)
    state
  end

  defp describe(:busy), do: "nobody read them"
  defp describe(reason), do: :file.format_error(reason)
end
