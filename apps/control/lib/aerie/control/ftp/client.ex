defmodule Aerie.Control.Ftp.Client do
  @moduledoc """
  One transfer of MAVLink FTP with a vehicle. Pure: `handle(client, event) -> {client, actions}`.

  Operations:

    * `{:list, path}` - `{:ok, [%{kind: :file | :directory, name, size}]}`
    * `{:read, path}` - by bursts; lost parts are requested again (T3). The bytes come as actions, in any order, each once
    * `{:write, path, bytes}` - creates or replaces the file, and compares checksums
    * `{:remove, path}`
    * `{:crc, path}` - `{:ok, crc}`
    * `:reset` - ends all sessions of the vehicle

  Paths and names are text as `Aerie.Control.Ftp.Name` writes it, whatever bytes the vehicle has.

  `Aerie.Control.Ftp.Exchange` repeats each request until it is answered (T2). A vehicle without a free session is asked to end them all: one
  owner serialises the transfers of a vehicle, so none of them is in use (T4). If the vehicle has lost a session, it is opened
  again, and the transfer continues where it was.

  Events are `{:start, now}`, `{:cancel, now}`, `{:message, message, {system, component}, now}` and `{:tick, now}` at `wake_at/1`
  at the latest, with `now` in microseconds of a clock that is never set. `{:rebooted, now}` is ignored: the vehicle itself reports
  that it does not know the session.

  Actions, in order: `{:send, messages}`; `{:data, offset, bytes}`; `{:progress, done, total}` (bytes; `total` is the size that the
  vehicle reported, which is too large for a generated file); `{:done, {:ok, value} | {:error, reason}}` once.
  """

  alias Aerie.Control.Ftp.{Exchange, Listing, Name, Reading, Writing}
  alias MavCodec.CRC
  alias MavCodec.Ftp.Packet
  alias MavCodec.Messages.FileTransferProtocol

  @reopenings 8
  @max_bytes 16 * 1024 * 1024

  @enforce_keys [:operation, :deadline, :exchange]
  defstruct [:operation, :us, :deadline, :exchange, :state, :size, reopenings: 0, phase: :idle]

  @type t :: %__MODULE__{}
  @type operation ::
          {:list | :read | :remove | :crc, Path.t()} | {:write, Path.t(), binary()} | :reset

  @typedoc """
  A refusal of the vehicle, or:

    * `:no_answer` - the vehicle does not answer (or has no FTP)
    * `:damaged` - the checksum of the written file is not that of the bytes
    * `:too_large` - more than `:max_bytes`, or #{Listing.max()} entries
    * `:changed` - the file had another size when it was opened again, or the vehicle generates it while it is read
    * `:bad_path` - empty, longer than 239 bytes, or with a NUL
    * `:deadline`, `:cancelled`
  """
  @type reason ::
          Packet.error()
          | :no_answer
          | :damaged
          | :too_large
          | :changed
          | :bad_path
          | :deadline
          | :cancelled
  @type event ::
          {:start | :cancel | :tick | :rebooted, integer()}
          | {:message, struct(), Packet.target(), integer()}
  @type action ::
          {:send, [struct(), ...]}
          | {:data, non_neg_integer(), binary()}
          | {:progress, non_neg_integer(), non_neg_integer()}
          | {:done, {:ok, term()} | {:error, reason()}}

  @doc """
  A transfer that has not begun.

  Options: `:seq` (`seq/1` of the previous transfer, so that its late answers are not taken for new ones), `:offset` (where a read or write
  continues), `:max_bytes` (of a read; #{div(@max_bytes, 1024 * 1024)} MiB), `:us` (`{system, component}` of the gateway; answers to others are
  ignored), `:rtt_us`, `:silent_us` (for how long the first request is repeated; #{div(Exchange.silence(), 1_000_000)} s and longer, as its answers may take); or, for `:seq` and `:rtt_us`, `:former`: the transfer with the same vehicle that has just ended.
  """
  @spec new(operation(), Packet.target(), deadline :: integer(), keyword()) :: t()
  def new(operation, target, deadline, options \\ []) do
    offset = Keyword.get(options, :offset, 0)

    state =
      case operation do
        {:list, _path} -> %Listing{}
        {:read, _path} -> Reading.new(offset, Keyword.get(options, :max_bytes, @max_bytes))
        {:write, _path, bytes} -> Writing.new(bytes, offset)
        _other -> nil
      end

    exchange =
      case options[:former] do
        %__MODULE__{exchange: former} -> Exchange.without_session(former)
        nil -> Exchange.new(target, options[:rtt_us], Keyword.get(options, :seq, 0), options[:silent_us])
      end

    %__MODULE__{
      operation: bytes(operation),
      us: options[:us],
      deadline: deadline,
      exchange: exchange,
      state: state
    }
  end

  defp bytes({operation, path}), do: {operation, Name.bytes(path)}
  defp bytes({:write, path, bytes}), do: {:write, Name.bytes(path), bytes}
  defp bytes(:reset), do: :reset

  @doc "The largest file that is read unless `:max_bytes` says otherwise, or written."
  @spec max_bytes() :: pos_integer()
  def max_bytes, do: @max_bytes

  @doc "When `{:tick, now}` has to come, nil for never."
  @spec wake_at(t()) :: integer() | nil
  def wake_at(%{phase: phase}) when phase in [:idle, :done], do: nil
  def wake_at(client), do: min(client.exchange.due, client.deadline)

  @doc "The number with which the next transfer with this vehicle has to begin."
  @spec seq(t()) :: 0..65_535
  def seq(client), do: client.exchange.seq

  @doc "Whether the vehicle has answered anything."
  @spec heard?(t()) :: boolean()
  def heard?(client), do: client.exchange.heard?

  @doc "How many bytes from the beginning were read or written: where another transfer can continue."
  @spec offset(t()) :: non_neg_integer()
  def offset(%{state: %module{} = state}) when module in [Reading, Writing], do: module.offset(state)
  def offset(_client), do: 0

  @spec handle(t(), event()) :: {t(), [action()]}
  def handle(%{phase: :done} = client, _event), do: {client, []}
  def handle(client, {:cancel, _now}), do: finish(client, {:error, :cancelled})

  def handle(%{deadline: deadline} = c, {_event, now}) when now >= deadline,
    do: finish(c, {:error, :deadline})

  def handle(%{phase: :idle} = client, {:start, now}) do
    if path?(client.operation), do: begin(client, now), else: finish(client, {:error, :bad_path})
  end

  def handle(%{phase: :idle} = client, _early), do: {client, []}
  def handle(%{exchange: %{due: due}} = client, {:tick, now}) when now >= due, do: late(client, now)

  def handle(%{exchange: %{target: from}} = client, {:message, %FileTransferProtocol{} = m, from, now}) do
    with true <- client.us in [nil, {m.target_system, m.target_component}],
         {kind, packet} <- Packet.answer(m),
         true <- Exchange.answer?(client.exchange, packet) do
      answered(%{client | exchange: Exchange.answered(client.exchange, packet, now)}, kind, packet, now)
    else
      _other -> {client, []}
    end
  end

  def handle(client, _other), do: {client, []}

  defp path?(:reset), do: true
  defp path?({_operation, path}), do: path?(path)
  defp path?({:write, path, _bytes}), do: path?(path)
  defp path?(path), do: byte_size(path) in 1..Packet.max_data() and not String.contains?(path, <<0>>)

  # --- requests ---

  defp begin(%{operation: operation} = client, now) do
    case operation do
      {:list, path} ->
        ask(client, :list, [data: path, offset: client.state.offset], now)

      {:read, path} ->
        ask(client, :open, [data: path], now)

      {:remove, path} ->
        ask(client, :remove, [data: path], now)

      {:crc, path} ->
        ask(client, :crc, [data: path], now)

      {:write, path, _bytes} ->
        ask(client, if(Writing.begun?(client.state), do: :open_to_write, else: :create), [data: path], now)

      :reset ->
        ask(client, :reset, [], now)
    end
  end

  defp ask(client, phase, fields, now) do
    {exchange, message} = Exchange.ask(client.exchange, phase, fields, now)
    {%{client | phase: phase, exchange: exchange}, [{:send, [message]}]}
  end

  defp late(%{phase: :terminate, exchange: %{repeats: 2}} = client, now), do: closed(client, now)

  defp late(%{phase: :burst, state: %{heard?: true}} = client, now),
    do: read_on(%{client | exchange: Exchange.after_burst(client.exchange)}, now)

  defp late(client, now) do
    case Exchange.again(client.exchange, now) do
      {exchange, message} -> {%{client | exchange: exchange}, [{:send, [message]}]}
      :give_up -> finish(client, {:error, :no_answer})
    end
  end

  # --- answers ---

  defp answered(%{phase: :list} = client, :ack, packet, now), do: listed(client, packet, now)
  defp answered(%{phase: :list} = client, :nak, packet, _now), do: list_ended(client, Packet.error(packet))

  defp answered(%{phase: phase} = client, :ack, packet, now) when phase in [:open, :open_to_write, :create],
    do: opened(client, packet, now)

  defp answered(%{phase: phase} = client, :nak, packet, now) when phase in [:open, :open_to_write, :create] do
    case Packet.error(packet) do
      :no_sessions ->
        reopen(client, :reset, now)

      # The file no longer exists, so all of it is written again.
      :file_not_found when phase == :open_to_write ->
        begin(%{client | state: Writing.again(client.state)}, now)

      error ->
        finish(client, {:error, error})
    end
  end

  defp answered(%{phase: :reset, operation: :reset} = client, _any, _packet, _now),
    do: finish(client, {:ok, nil})

  defp answered(%{phase: :reset} = client, _any, _packet, now), do: begin(client, now)

  defp answered(%{state: %Reading{}} = client, :ack, packet, now), do: took(client, packet, now)

  defp answered(%{state: %Reading{}} = client, :nak, packet, now) do
    case Packet.error(packet) do
      :eof ->
        read_on(%{client | state: Reading.ended(client.state, packet, client.exchange.request)}, now)

      :unknown_command when client.phase == :burst ->
        read_on(%{client | state: Reading.without_bursts(client.state)}, now)

      :invalid_session ->
        reopen(client, nil, now)

      error ->
        close(client, {:error, error})
    end
  end

  defp answered(%{phase: :write} = client, :ack, _packet, now) do
    {state, progress} = Writing.written(client.state, client.exchange.request)
    write_on(%{client | state: state}, progress, now)
  end

  defp answered(%{phase: :write} = client, :nak, packet, now) do
    case Packet.error(packet) do
      :invalid_session -> reopen(client, nil, now)
      error -> close(client, {:error, error})
    end
  end

  defp answered(%{phase: :terminate} = client, _any, _packet, now), do: closed(client, now)

  defp answered(%{phase: :crc} = client, :ack, %{data: <<crc::little-32, _rest::binary>>}, _now),
    do: checked(client, crc)

  # The server has no checksums, so the acknowledgements have to suffice.
  defp answered(%{phase: :crc, operation: {:write, _path, _bytes}} = client, :nak, packet, _now) do
    if Packet.error(packet) == :unknown_command,
      do: finish(client, {:ok, :unverified}),
      else: finish(client, {:error, Packet.error(packet)})
  end

  defp answered(%{phase: :remove} = client, :ack, _packet, _now), do: finish(client, {:ok, nil})

  # The answer to the first request may have been lost.
  defp answered(%{phase: :remove, exchange: %{repeats: repeats}} = client, :nak, packet, _now) do
    error = Packet.error(packet)
    finish(client, if(error == :file_not_found and repeats > 0, do: {:ok, nil}, else: {:error, error}))
  end

  defp answered(client, :nak, packet, _now), do: finish(client, {:error, Packet.error(packet)})
  defp answered(client, _kind, _packet, _now), do: {client, []}

  # --- directories ---

  defp listed(client, packet, now) do
    case Listing.took(client.state, packet.data) do
      {:more, listing} -> begin(%{client | state: listing}, now)
      :ended -> list_ended(client, :eof)
      :too_large -> finish(client, {:error, :too_large})
    end
  end

  defp list_ended(client, :eof), do: finish(client, {:ok, Listing.entries(client.state)})
  defp list_ended(client, error), do: finish(client, {:error, error})

  # --- sessions ---

  defp opened(client, packet, now) do
    size = with <<size::little-32, _rest::binary>> <- packet.data, do: size, else: (_none -> nil)

    client = %{client | exchange: Exchange.opened(client.exchange, packet.session)}

    cond do
      not match?(%Reading{}, client.state) ->
        write_on(client, [], now)

      client.size not in [nil, size] ->
        close(client, {:error, :changed})

      true ->
        told = if match?({:read, "@" <> _made}, client.operation), do: :made, else: size
        state = Reading.opened(client.state, told)
        read_on(%{client | exchange: Exchange.expect_bursts(client.exchange), size: size, state: state}, now)
    end
  end

  defp reopen(%{reopenings: @reopenings} = client, _first, _now),
    do: finish(client, {:error, :invalid_session})

  # After a restart a generated file may be another one with the same size.
  defp reopen(%{operation: {:read, "@" <> _generated}, size: size} = client, _first, _now) when size != nil,
    do: finish(client, {:error, :changed})

  defp reopen(client, first, now) do
    exchange = Exchange.without_session(client.exchange)
    client = %{client | reopenings: client.reopenings + 1, exchange: exchange}
    if first == :reset, do: ask(client, :reset, [], now), else: begin(client, now)
  end

  # The answer does not matter (T4): if the request is lost, the vehicle reports next time that it has no free session.
  defp close(client, result) do
    {exchange, message} = Exchange.send_only(client.exchange, :terminate)
    {client, done} = finish(%{client | exchange: exchange}, result)
    {client, [{:send, [message]} | done]}
  end

  # --- reading ---

  defp took(client, packet, now) do
    case Reading.took(client.state, packet) do
      {:too_large, _state} ->
        close(client, {:error, :too_large})

      {new, state} ->
        exchange = Exchange.took(client.exchange, packet)
        client = %{client | state: state, exchange: exchange}
        data = Enum.map(new, fn {offset, bytes} -> {:data, offset, bytes} end)
        progress = if new == [], do: [], else: [{:progress, Reading.size(state), client.size || 0}]
        over? = packet.complete or packet.request == Packet.opcode(:read)

        {client, more} =
          if over?, do: read_on(client, now), else: {%{client | exchange: Exchange.wait(exchange, now)}, []}

        {client, data ++ progress ++ more}
    end
  end

  defp read_on(client, now) do
    case Reading.next(client.state) do
      {:done, size} ->
        close(client, {:ok, size})

      {phase, offset, state} ->
        ask(%{client | state: state}, phase, [offset: offset, size: Packet.max_data()], now)
    end
  end

  # --- writing ---

  defp write_on(client, actions, now) do
    {client, more} =
      case Writing.next(client.state) do
        {offset, bytes} -> ask(client, :write, [offset: offset, data: bytes], now)
        :done -> ask(client, :terminate, [], now)
      end

    {client, actions ++ more}
  end

  # The vehicle flushes the file when the session ends.
  defp closed(%{operation: {:write, path, _bytes}} = client, now), do: ask(client, :crc, [data: path], now)

  defp checked(%{operation: {:write, _path, bytes}} = client, crc),
    do: finish(client, if(crc == CRC.crc32(bytes), do: {:ok, :verified}, else: {:error, :damaged}))

  defp checked(client, crc), do: finish(client, {:ok, crc})

  defp finish(client, result), do: {%{client | phase: :done}, [{:done, result}]}
end
