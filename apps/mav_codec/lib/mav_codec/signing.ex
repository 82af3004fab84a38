defmodule MavCodec.Signing do
  @moduledoc """
  Signs the frames sent on a link and checks those received (S1-S7, S12). A value, one per link and key.

      signing = MavCodec.Signing.new(key, link_id: 1, stored: read_from_disk, save: &write_to_disk/1)
      {bytes, signing} = MavCodec.Signing.encode(signing, message, system: 237, component: 191)
      {verdict, signing} = MavCodec.Signing.check(signing, frame)

  ## Time stamps

  Units of 10 us since 2015-01-01. The whole link has one time stamp: the clock's, or one more than the last if the clock
  has not moved (S12) or is behind a received valid signature (S5). The time stamps of each received stream
  {link id, system, component} must increase (S3); a new stream may be one minute behind (S4).

  The time must survive a restart even without a clock (S6). `save` is called with a future time stamp, and again before it
  is reached, at least once per 30 s of time stamps; with the saved value as `stored`, no time stamp is used twice. It is also
  called when a stream is new or runs further ahead of the clock than before: from `streams/1` and `ahead/1` at that moment,
  `resumed/3` computes what may have been received before a crash.

  ## Clocks that are wrong

  A time stamp that is more than ten years ahead (a program that counts from 1970 is 45 years ahead) is accepted, as a
  stream of its own, but it does not set our time, by which others are measured; with `follow_far: true`, where nobody
  else has the key, it does. One that is an hour ahead makes no first frames of others stale, if our clock is right.
  `leads/1` lists how far each one is ahead.

  ## Safety

  State changes only after a valid signature (S5), so nobody without the key can fill or shift it. The key is kept in a
  closure and never shown by `inspect/2` or in crash reports (S9).
  """

  import Bitwise

  alias MavCodec.{CRC, Frame}
  alias MavCodec.Message.EncodeError

  @signed 0x01
  @signature_size 13
  # 2015-01-01T00:00:00Z as unix time, in 10 us.
  @epoch 142_007_040_000_000
  @minute 6_000_000
  @save_ahead div(@minute, 2)
  # The next timestamp is stored this long before the stored one is reached, because writing takes time.
  @save_early 100_000
  # A stream that runs ahead by this much more is stored.
  @slack 20_000
  @max_streams 1024
  @radio_status 109
  @max_timestamp 0xFFFF_FFFF_FFFF
  @hour 60 * @minute
  @far 3_653 * 24 * @hour
  # 2026-01-01: a clock that says an earlier time is wrong itself.
  @built 34_715_520_000_000
  # Streams of time stamps that are too far ahead have these link ids and above.
  @far_link 256

  @enforce_keys [:key, :link_id, :clock, :save, :accept_unsigned]
  defstruct @enforce_keys ++ [:leads, timestamp: 0, reserved: 0, limit: 0, follow_far: false, streams: %{}]

  @typedoc "Units of 10 us since 2015-01-01T00:00:00Z, 48 bits."
  @type timestamp :: 0..0xFFFF_FFFF_FFFF

  @typedoc "Its fields are private; `inspect/2` hides the key."
  @type t :: %__MODULE__{
          key: (-> <<_::256>>),
          link_id: 0..255,
          clock: (-> integer()),
          save: (timestamp() -> any()),
          accept_unsigned: [non_neg_integer()] | (Frame.t() -> boolean()),
          timestamp: timestamp(),
          reserved: timestamp(),
          limit: timestamp(),
          follow_far: boolean(),
          leads: {system :: non_neg_integer(), component :: 0..255, by_us :: pos_integer()} | nil,
          streams: %{
            optional({0..255, non_neg_integer(), 0..255}) => {timestamp(), integer(), integer() | nil}
          }
        }

  @typedoc """
    * `:link_id` - of this end of the link, 0..255; default 0
    * `:stored` - the time stamp that `save` was last given before a restart; default 0
    * `:save` - called with the time stamp to store (S6); default: nothing is stored
    * `:accept_unsigned` - message ids that are accepted without a signature, or a function of the frame; default
      `[#{@radio_status}]`, RADIO_STATUS, which radios send themselves (S7)
    * `:clock` - a function that returns unix microseconds; default: the system's clock
    * `:follow_far` - whether our time follows any that is received; default false
    * `:streams` - what `streams/1` returned before a restart, so that frames recorded before cannot be replayed after
      it (S3)
  """
  @type option ::
          {:link_id, 0..255}
          | {:follow_far, boolean()}
          | {:stored, timestamp()}
          | {:save, (timestamp() -> any())}
          | {:accept_unsigned, [non_neg_integer()] | (Frame.t() -> boolean())}
          | {:clock, (-> integer())}
          | {:streams, %{optional(stream()) => timestamp()}}

  @typedoc "A signer: link id of the signature, system, component."
  @type stream :: {link_id :: 0..511, system :: non_neg_integer(), component :: 0..255}

  @typedoc """
    * `:signed` - the signature is valid
    * `:unsigned` - there is none, and none is needed
    * `{:rejected, :unsigned}` - the signature is missing
    * `{:rejected, :wrong_signature}` - made with another key, damaged, or memory garbage that a firmware forwards
    * `{:rejected, :replayed}` - the time stamp is not above the last one of its stream (S3)
    * `{:rejected, :stale}` - the first of a stream, more than a minute old (S4)
    * `{:rejected, :too_many_streams}` - more than #{@max_streams} streams with valid signatures

  A caller that accepts a rejected frame must show the operator that the link is unsafe (S11). Forwarding does not depend on
  the verdict (S10).
  """
  @type verdict ::
          :signed
          | :unsigned
          | {:rejected, :unsigned | :wrong_signature | :replayed | :stale | :too_many_streams}

  @doc "Signing with a secret `key` of 32 bytes."
  @spec new(<<_::256>>, [option()]) :: t()
  def new(<<key::binary-size(32)>>, options \\ []) do
    options =
      Keyword.validate!(options,
        link_id: 0,
        follow_far: false,
        stored: 0,
        save: fn _timestamp -> :ok end,
        accept_unsigned: [@radio_status],
        clock: fn -> System.os_time(:microsecond) end,
        streams: %{}
      )

    signing = %__MODULE__{
      key: fn -> key end,
      link_id: options[:link_id],
      clock: options[:clock],
      save: options[:save],
      accept_unsigned: options[:accept_unsigned],
      follow_far: options[:follow_far],
      streams:
        for(
          {stream, last} <- Enum.take(options[:streams], @max_streams),
          into: %{},
          do: {stream, {last, -1, nil}}
        )
    }

    now = now(signing)
    reserve(%{signing | limit: limit(now), timestamp: max(now, options[:stored])})
  end

  @doc "The stream of a signed frame."
  @spec stream(t(), Frame.t()) :: stream()
  def stream(signing, %Frame{signature: %{link_id: link_id, timestamp: timestamp}} = frame) do
    line = if timestamp > signing.limit, do: @far_link, else: 0
    {link_id + line, frame.system, frame.component}
  end

  @doc "Who was found to be more than an hour ahead of our clock since the last call, and by how much."
  @spec leads(t()) :: {{system :: non_neg_integer(), component :: 0..255, by_us :: pos_integer()} | nil, t()}
  def leads(signing), do: {signing.leads, %{signing | leads: nil}}

  @doc "Whether our time is one that nobody else's may be measured by."
  @spec far?(t()) :: boolean()
  def far?(signing), do: signing.timestamp > signing.limit

  @doc "The key that ground stations derive from a passphrase: its SHA-256."
  @spec key(String.t()) :: <<_::256>>
  def key(passphrase), do: :crypto.hash(:sha256, passphrase)

  @doc "The last time stamp used or received, for SETUP_SIGNING's `initial_timestamp`."
  @spec timestamp(t()) :: timestamp()
  def timestamp(%__MODULE__{timestamp: timestamp}), do: timestamp

  @doc "The last time stamp that was accepted of each stream."
  @spec streams(t()) :: %{optional(stream()) => timestamp()}
  def streams(%__MODULE__{streams: streams}),
    do: Map.new(streams, fn {stream, {last, _until, _ahead}} -> {stream, last} end)

  @doc "An upper bound of how far each stream was ahead of the clock since the start (10 us; negative: behind)."
  @spec ahead(t()) :: %{optional(stream()) => integer()}
  def ahead(%__MODULE__{streams: streams} = signing) do
    now = now(signing)

    # After the clock was set back, frames up to `until` are still accepted without reading it.
    for {stream, {_last, until, ahead}} when ahead != nil <- streams,
        into: %{},
        do: {stream, max(ahead, until - now)}
  end

  @doc """
  The `:streams` to begin with after a crash: upper bounds of the time stamps received before it.

  `streams` has the last time stamp of each and the result of `ahead/1` (nil: unknown), `stored` is what `save` was given, all
  at `at`. `now` is the clock (`at` and `now` in unix microseconds). A stream was not further ahead of the clock than that, nor
  beyond the stored time stamp. If the clock was set back meanwhile, only the latter counts.
  """
  @spec resumed(%{optional(stream()) => {timestamp(), integer() | nil}}, timestamp(), {
          at :: integer() | nil,
          now :: integer()
        }) :: %{optional(stream()) => timestamp()}
  def resumed(streams, stored, {at, now}) do
    Map.new(streams, fn
      {stream, {last, ahead}} when ahead != nil and at != nil and now >= at ->
        # One that is too far ahead is beyond what we stored of our time.
        bound = if last > stored, do: units(now) + ahead, else: min(stored, units(now) + ahead)
        {stream, max(last, bound)}

      {stream, {last, _unknown}} ->
        {stream, max(last, stored)}
    end)
  end

  @doc "A time stamp as unix microseconds."
  @spec to_unix(timestamp()) :: integer()
  def to_unix(timestamp) when is_integer(timestamp), do: (timestamp + @epoch) * 10

  ## Sending

  @doc "The signed frame of a message; options and errors of `MavCodec.encode/2`, version 2 only."
  @spec encode(t(), MavCodec.Message.t(), [MavCodec.encode_option()]) :: {binary(), t()}
  def encode(signing, message, options) do
    flags = Keyword.get(options, :incompat_flags, 0) ||| @signed
    frame = MavCodec.encode(message, Keyword.put(options, :incompat_flags, flags))
    check_version(frame)
    append(signing, frame)
  end

  @doc """
  Signs an unsigned v2 frame. The header gets the flag, and the CRC covers the header, so `crc_extra` is needed. Raises
  `MavCodec.Message.EncodeError` for a v1 frame: version 1 has no signatures.
  """
  @spec sign(t(), binary(), 0..255) :: {binary(), t()}
  def sign(signing, frame, crc_extra) do
    check_version(frame)
    append(signing, with_flags(frame, crc_extra, &(&1 ||| @signed)))
  end

  defp check_version(<<0xFD, _::binary>>), do: :ok

  defp check_version(_frame),
    do: raise(EncodeError, field: :version, got: 1, expected: "2, version 1 has no signatures")

  defp append(signing, frame) do
    timestamp = max(now(signing), signing.timestamp + 1)
    block = <<signing.link_id, timestamp::48-little>>
    signature = signature(signing, <<0::size(0), frame::binary, block::binary>>)
    {<<frame::binary, block::binary, signature::binary>>, reserve(%{signing | timestamp: timestamp})}
  end

  ## Receiving

  @doc "Checks the signature of a frame that a parser accepted."
  @spec check(t(), Frame.t()) :: {verdict(), t()}
  def check(%__MODULE__{} = signing, %Frame{signature: nil} = frame) do
    if unsigned?(signing.accept_unsigned, frame),
      do: {:unsigned, signing},
      else: {{:rejected, :unsigned}, signing}
  end

  def check(
        %__MODULE__{streams: streams} = signing,
        %Frame{signature: %{timestamp: timestamp, signature: given}} = frame
      ) do
    stream = stream(signing, frame)

    if right?(signing.key.(), frame.bytes, given) do
      case streams do
        # The common case: the clock is not read.
        %{^stream => {last, until, ahead}} when timestamp > last and timestamp <= until ->
          {:signed, accept(signing, %{streams | stream => {timestamp, until, ahead}}, timestamp)}

        %{^stream => {last, _until, ahead}} when timestamp > last ->
          {:signed, leading(signing, stream, timestamp, ahead)}

        %{^stream => _not_before} ->
          {{:rejected, :replayed}, signing}

        _ ->
          case refusal(signing, timestamp) do
            nil -> {:signed, leading(signing, stream, timestamp, nil)}
            reason -> {{:rejected, reason}, signing}
          end
      end
    else
      {{:rejected, :wrong_signature}, signing}
    end
  end

  defp accept(%{limit: limit, follow_far: false} = signing, streams, timestamp) when timestamp > limit,
    do: %{signing | streams: streams}

  defp accept(signing, streams, timestamp),
    do: reserve(%{signing | streams: streams, timestamp: max(signing.timestamp, timestamp)})

  # The first frame of a stream, or one that may be further ahead of the clock than any before. Each stream has a time stamp
  # up to which the clock need not be read, so it is read five times a second.
  defp leading(signing, stream, timestamp, ahead) do
    now = now(signing)
    by = timestamp - now
    most = if ahead == nil or by > ahead, do: by + @slack, else: ahead
    signing = accept(signing, Map.put(signing.streams, stream, {timestamp, now + most, most}), timestamp)
    if most != ahead, do: signing.save.(min(signing.reserved, @max_timestamp))
    {_link_id, system, component} = stream
    leads = if by > @hour, do: {system, component, by * 10}, else: signing.leads
    %{signing | limit: limit(now), leads: leads}
  end

  defp limit(now), do: max(now, @built) + @far

  # As numbers of 48 bits, which are compared in constant time.
  defp right?(key, bytes, <<given::48>>) do
    <<signature::48, _::binary>> = hash(key, bytes, byte_size(bytes) - 6)
    signature == given
  end

  defp unsigned?(ids, frame) when is_list(ids), do: frame.id in ids
  defp unsigned?(accept?, frame), do: accept?.(frame)

  # Why the first frame of a stream is not accepted.
  defp refusal(signing, timestamp) do
    now = now(signing)
    ahead? = now >= @built and signing.timestamp > now + @hour

    cond do
      timestamp + @minute < signing.timestamp and not ahead? -> :stale
      map_size(signing.streams) >= @max_streams -> :too_many_streams
      timestamp + @minute < now -> :stale
      true -> nil
    end
  end

  # S1: the first 48 bits of SHA-256 over the key and everything before the signature.
  defp signature(signing, covered) do
    <<signature::binary-size(6), _::binary>> = hash(signing.key.(), covered, byte_size(covered))
    signature
  end

  # One binary: crypto takes longer for a list, and half as long again for a context that has the key already. The empty
  # first segment prevents an append.
  defp hash(key, bytes, covered),
    do: :crypto.hash(:sha256, <<0::size(0), key::binary-size(32), bytes::binary-size(covered)>>)

  ## Time

  defp now(signing), do: units(signing.clock.())
  defp units(unix_us), do: (div(unix_us, 10) - @epoch) |> max(0) |> min(@max_timestamp)

  # S6: the stored timestamp is always ahead of the used ones.
  defp reserve(%{timestamp: timestamp, reserved: reserved} = signing)
       when timestamp < reserved - @save_early,
       do: signing

  defp reserve(%{timestamp: timestamp} = signing) do
    reserved = timestamp + @save_ahead
    signing.save.(min(reserved, @max_timestamp))
    %{signing | reserved: reserved}
  end

  ## Logs

  @doc """
  The frame without its signature: flag cleared, CRC recomputed. An unsigned frame, and one of an unknown id, whose CRC
  cannot be computed, stay as they are.
  """
  @spec strip(Frame.t()) :: Frame.t()
  def strip(%Frame{signature: nil} = frame), do: frame
  def strip(%Frame{crc_extra: nil} = frame), do: frame

  def strip(%Frame{bytes: bytes, crc_extra: extra, at: at}) do
    bytes
    |> binary_part(0, byte_size(bytes) - @signature_size)
    |> with_flags(extra, &(&1 &&& bnot(@signed)))
    |> Frame.from_bytes(extra, at)
  end

  defp with_flags(<<0xFD, len, incompat, rest::binary>>, crc_extra, change) do
    body = binary_part(rest, 0, byte_size(rest) - 2)
    frame = <<0xFD, len, change.(incompat), body::binary>>
    <<frame::binary, CRC.frame(frame, byte_size(frame) - 1, crc_extra)::16-little>>
  end

  defimpl Inspect do
    import Inspect.Algebra

    def inspect(signing, opts) do
      shown = [link_id: signing.link_id, timestamp: signing.timestamp, streams: map_size(signing.streams)]
      concat(["#MavCodec.Signing<", to_doc(shown, opts), ">"])
    end
  end
end
