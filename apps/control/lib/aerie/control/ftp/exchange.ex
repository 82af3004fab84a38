defmodule Aerie.Control.Ftp.Exchange do
  @moduledoc """
  One request at a time and its answers: numbers, repetitions and time-outs (T2). Pure.

  A request is repeated with the same number until it is answered; the vehicle answers a repetition with its last
  answer. A burst is answered by many packets, whose numbers continue from the request's.
  """

  alias Aerie.Control.Ftp.RoundTrip
  alias MavCodec.Ftp.Packet

  @repeats 24
  # A vehicle that has answered before is likely to do so again.
  @first_repeats 8
  @silence RoundTrip.silence()
  @burst_numbers 4_096
  # The vehicle reads the whole file before it answers.
  @crc_wait 300_000
  @crc Packet.opcode(:crc)

  @enforce_keys [:target, :trip]
  defstruct [
    :target,
    :trip,
    :request,
    :due,
    :sent_at,
    :first_seq,
    :silent,
    patience: 0,
    seq: 0,
    session: 0,
    repeats: 0,
    heard?: false
  ]

  @typedoc """
    * `due` - when the request has to be repeated, in microseconds
    * `sent_at` - when the request was sent first, until its answer has come
    * `patience` - the shortest wait, because the last answer took so long that its request was repeated (0: it was not)
    * `seq` - the number of the next request
    * `first_seq` - burst packets with numbers from here on belong to this session; nil before a file is open for
      reading
    * `silent` - for how long a vehicle that has answered nothing is asked; one that has answered something, twice as
      long for each request, or longer on a slow link. nil for as long as the repetitions take
    * `heard?` - whether the vehicle has answered anything
  """
  @type t :: %__MODULE__{}

  @doc "An exchange that has sent nothing; the first request has the number `seq`."
  @spec new(
          Packet.target(),
          rtt_us :: non_neg_integer() | nil,
          seq :: 0..65_535,
          silent_us :: pos_integer() | nil
        ) ::
          t()
  def new(target, rtt, seq, silent \\ nil),
    do: %__MODULE__{target: target, trip: RoundTrip.new(rtt), seq: seq, silent: silent}

  @doc "The shortest time for which a vehicle is asked that does not answer."
  @spec silence() :: pos_integer()
  def silence, do: @silence

  @doc "Records the session that the vehicle opened."
  @spec opened(t(), byte()) :: t()
  def opened(exchange, session), do: %{exchange | session: session}

  @doc "Opens the session for reading: packets of bursts count as answers from now on."
  @spec expect_bursts(t()) :: t()
  def expect_bursts(exchange), do: %{exchange | first_seq: exchange.seq}

  @doc "Forgets the session, which is lost or ended; what was learnt of the vehicle and of the way to it stays."
  @spec without_session(t()) :: t()
  def without_session(exchange), do: %{exchange | session: 0, first_seq: nil}

  @doc "Makes a new request by the name of its opcode."
  @spec ask(t(), atom(), keyword(), integer()) :: {t(), struct()}
  def ask(exchange, opcode, fields, now) do
    packet = struct!(packet(exchange, opcode), fields)
    packet = if packet.size == 0, do: %{packet | size: byte_size(packet.data)}, else: packet
    transmit(%{exchange | request: packet, repeats: 0, sent_at: now, seq: next(exchange.seq)}, now)
  end

  @doc "Makes a request whose answer does not matter."
  @spec send_only(t(), atom()) :: {t(), struct()}
  def send_only(exchange, opcode),
    do: {%{exchange | seq: next(exchange.seq)}, Packet.message(packet(exchange, opcode), exchange.target)}

  @doc "Repeats the request, because no answer has come."
  @spec again(t(), integer()) :: {t(), struct()} | :give_up
  def again(%{repeats: @repeats}, _now), do: :give_up

  def again(%{repeats: repeats, heard?: false, sent_at: at}, now)
      when repeats >= @first_repeats and now - at >= @silence,
      do: :give_up

  def again(%{silent: silent, sent_at: at} = exchange, now) when silent != nil and at != nil do
    if now - at >= patience(exchange), do: :give_up, else: repeat(exchange, now)
  end

  def again(exchange, now), do: repeat(exchange, now)

  defp repeat(exchange, now), do: transmit(%{exchange | repeats: exchange.repeats + 1}, now)

  defp patience(%{heard?: false, silent: silent}), do: silent

  defp patience(exchange),
    do: Enum.max([2 * exchange.silent, 4 * RoundTrip.timeout(exchange.trip), 4 * exchange.patience])

  @doc """
  Gives up on the rest of a burst, which is lost or late. The number of the next request must not be among those of the
  burst: a late EOF would look like its answer.
  """
  @spec after_burst(t()) :: t()
  def after_burst(exchange) do
    seq = Bitwise.band(exchange.seq + @burst_numbers, 0xFFFF)
    %{exchange | seq: seq, first_seq: exchange.request.seq}
  end

  @doc "Whether a packet is an answer to the request, or belongs to a burst of this session."
  @spec answer?(t(), Packet.t()) :: boolean()
  def answer?(%{request: %{opcode: opcode}} = exchange, packet) do
    (packet.request == opcode and follows?(exchange, packet)) or
      (packet.request == Packet.opcode(:burst) and exchange.first_seq != nil and
         packet.session == exchange.session and not before?(packet.seq, exchange.first_seq))
  end

  @doc """
  Records an answer. If its request was sent once, that measures the round trip; if it was repeated, nobody knows to
  which of them it is the answer, and the next requests wait as long as it took (Karn's rule, RFC 6298).
  """
  @spec answered(t(), Packet.t(), integer()) :: t()
  def answered(%{sent_at: at, request: request} = exchange, packet, now) when at != nil do
    exchange = %{exchange | heard?: true}

    cond do
      packet.request != request.opcode or not follows?(exchange, packet) -> exchange
      # Its time is that of reading the file.
      request.opcode == @crc -> exchange
      exchange.repeats > 0 -> %{exchange | patience: now - at, sent_at: nil}
      true -> %{exchange | trip: RoundTrip.sample(exchange.trip, now - at), patience: 0, sent_at: nil}
    end
  end

  def answered(exchange, _packet, _now), do: %{exchange | heard?: true}

  @doc "Records a packet with data; the next request has a number after the packet's."
  @spec took(t(), Packet.t()) :: t()
  def took(exchange, packet) do
    seq = next(packet.seq)

    %{
      exchange
      | repeats: 0,
        sent_at: if(exchange.repeats == 0, do: exchange.sent_at),
        seq: if(before?(seq, exchange.seq), do: exchange.seq, else: seq)
    }
  end

  @doc "Waits for more packets of the burst."
  @spec wait(t(), integer()) :: t()
  def wait(exchange, now), do: %{exchange | due: now + timeout(exchange)}

  defp packet(exchange, opcode),
    do: %Packet{seq: exchange.seq, session: exchange.session, opcode: Packet.opcode(opcode)}

  defp transmit(exchange, now) do
    exchange = wait(exchange, now)

    {%{exchange | due: min(exchange.due, patient_until(exchange))},
     Packet.message(exchange.request, exchange.target)}
  end

  # nil is greater than any number.
  defp patient_until(%{silent: silent, heard?: false, sent_at: at}) when silent != nil, do: at + silent
  defp patient_until(_exchange), do: nil

  defp timeout(%{request: %{opcode: @crc}} = exchange),
    do: max(@crc_wait, RoundTrip.timeout(exchange.trip)) * Integer.pow(2, min(exchange.repeats, 5))

  defp timeout(exchange),
    do:
      max(
        RoundTrip.timeout(exchange.trip, div(exchange.repeats, 4)),
        min(exchange.patience, RoundTrip.longest())
      )

  defp follows?(%{request: request}, packet), do: packet.seq == next(request.seq)
  defp next(seq), do: Bitwise.band(seq + 1, 0xFFFF)
  defp before?(seq, other), do: Bitwise.band(seq - other, 0xFFFF) >= 0x8000
end
