defmodule Aerie.Fleet.Tracks.Block do
  @moduledoc """
  The codec of a file of tracks: the samples of all vehicles at one moment are a block. Pure.

      size::24  crc32::32  payload
      payload:  1 at::48            the first block of a group, unix milliseconds
             or 2 after             any other one, milliseconds after the first
                then samples to the end:
      sample:   number [name]  mask  change*  [mode [word]]

  A group begins about once a minute and needs nothing before it: names of vehicles and modes are numbered in the
  order in which they come, and a sample has what changed since the vehicle's last one in the group. So a group is
  read alone, and damage ends at the next one. Numbers are LEB128. A change is the difference, zigzag-coded and 1
  more, or 0 where the value is no longer known.
  """

  import Bitwise

  alias Aerie.Fleet.Tracks.Sample

  @head 7
  @max_bytes 2_097_152
  @max_vehicles 4_096
  @max_name 128
  @max_word 32
  @numbers Sample.numbers()
  @mode_bit 1 <<< length(@numbers)

  @type group :: %{start: integer() | nil, vehicles: map(), last: map(), modes: map()}

  @doc "The most vehicles of a block."
  @spec max_vehicles() :: pos_integer()
  def max_vehicles, do: @max_vehicles

  @doc "Whether a name can be written."
  @spec name?(term()) :: boolean()
  def name?(name), do: is_binary(name) and byte_size(name) in 1..@max_name

  @doc "No group yet: the next block begins one."
  @spec new() :: group()
  def new, do: %{start: nil, vehicles: %{}, last: %{}, modes: %{}}

  @doc "Whether the group has begun, and when (unix milliseconds)."
  @spec start(group()) :: integer() | nil
  def start(%{start: start}), do: start

  @doc "A block of samples: at most `max_vehicles/0` of them, with names as `name?/1` wants them."
  @spec encode(group(), at :: non_neg_integer(), [{String.t(), Sample.t()}]) :: {iodata(), group()}
  def encode(%{start: nil} = group, at, samples), do: block(%{group | start: at}, [<<1, at::48>>], samples)
  def encode(group, at, samples), do: block(group, [2, varint(max(at - group.start, 0))], samples)

  defp block(group, head, samples) do
    {samples, group} = Enum.map_reduce(samples, group, &sample/2)
    payload = IO.iodata_to_binary([head | samples])
    {[<<byte_size(payload)::24, :erlang.crc32(payload)::32>>, payload], group}
  end

  defp sample({name, sample}, group) do
    {number, named, group} = vehicle(name, group)
    {mode, word, group} = mode(sample.mode, group)
    last = Map.get(group.last, name, %Sample{})
    {mask, changes} = changes(@numbers, sample, last, 1, 0, [])

    {mask, changes} =
      if sample.mode == last.mode, do: {mask, changes}, else: {mask ||| @mode_bit, [[mode | word] | changes]}

    {[number, named, varint(mask) | Enum.reverse(changes)],
     %{group | last: Map.put(group.last, name, sample)}}
  end

  defp vehicle(name, %{vehicles: vehicles} = group) do
    case vehicles do
      %{^name => number} ->
        {varint(number), [], group}

      _new ->
        number = map_size(vehicles)
        {varint(number), [byte_size(name), name], %{group | vehicles: Map.put(vehicles, name, number)}}
    end
  end

  defp mode(nil, group), do: {0, [], group}

  defp mode(word, %{modes: modes} = group) do
    case modes do
      %{^word => number} ->
        {varint(number), [], group}

      _new ->
        number = map_size(modes) + 1
        {varint(number), [byte_size(word), word], %{group | modes: Map.put(modes, word, number)}}
    end
  end

  defp changes([], _sample, _last, _bit, mask, changes), do: {mask, changes}

  defp changes([field | rest], sample, last, bit, mask, changes) do
    case {Map.fetch!(sample, field), Map.fetch!(last, field)} do
      {same, same} ->
        changes(rest, sample, last, bit <<< 1, mask, changes)

      {nil, _known} ->
        changes(rest, sample, last, bit <<< 1, mask ||| bit, [0 | changes])

      {new, old} ->
        changes(rest, sample, last, bit <<< 1, mask ||| bit, [varint(zigzag(new - (old || 0)) + 1) | changes])
    end
  end

  defp zigzag(n) when n >= 0, do: n <<< 1
  defp zigzag(n), do: (-n <<< 1) - 1

  defp varint(n) when n < 128, do: n
  defp varint(n), do: [(n &&& 127) ||| 128 | List.wrap(varint(n >>> 7))]

  @doc "Reads the next block from a file (`Aerie.Base.Segments.Segment`): whether it begins a group, and when."
  @spec read(:file.fd()) ::
          {:ok, {{:group, at :: non_neg_integer()} | :block, bytes}, bytes}
          | :eof
          | {:torn, binary()}
          | :damaged
          | {:error, term()}
        when bytes: pos_integer()
  def read(file) do
    case :file.read(file, @head) do
      {:ok, <<size::24, crc::32>> = head} when size <= @max_bytes ->
        payload(:file.read(file, size), head, size, crc)

      {:ok, head} when byte_size(head) < @head ->
        {:torn, head}

      {:ok, _other} ->
        :damaged

      eof_or_error ->
        eof_or_error
    end
  end

  defp payload({:ok, payload}, _head, size, crc) when byte_size(payload) == size do
    if :erlang.crc32(payload) == crc, do: {:ok, {kind(payload), @head + size}, @head + size}, else: :damaged
  end

  defp payload({:ok, part}, head, _size, _crc), do: {:torn, head <> part}
  defp payload(:eof, head, _size, _crc), do: {:torn, head}
  defp payload(error, _head, _size, _crc), do: error

  defp kind(<<1, at::48, _samples::binary>>), do: {:group, at}
  defp kind(_other), do: :block

  @doc """
  Takes whole blocks off the front of bytes, and gives each to `fun` as it is read: time (unix milliseconds) and
  samples. Returns the bytes that are left: less than a block. `{:error, acc}` if something else follows; the rest
  cannot be read then.
  """
  @spec fold(group(), binary(), acc, (at :: integer(), [{String.t(), Sample.t()}], acc ->
                                        {:cont | :halt, acc})) ::
          {:ok, group(), rest :: binary(), acc} | {:halted, acc} | {:error, acc}
        when acc: term()
  def fold(group, <<size::24, crc::32, payload::binary-size(size), rest::binary>>, acc, fun)
      when size <= @max_bytes do
    with true <- :erlang.crc32(payload) == crc, {:ok, at, samples, group} <- decode(group, payload) do
      case fun.(at, samples, acc) do
        {:cont, acc} -> fold(group, rest, acc, fun)
        {:halt, acc} -> {:halted, acc}
      end
    else
      _damaged -> {:error, acc}
    end
  end

  def fold(_group, <<size::24, _rest::binary>>, acc, _fun) when size > @max_bytes, do: {:error, acc}
  def fold(group, rest, acc, _fun), do: {:ok, group, rest, acc}

  defp decode(_group, <<1, at::48, samples::binary>>), do: samples(samples, %{new() | start: at}, at, [])

  defp decode(%{start: start} = group, <<2, bytes::binary>>) when start != nil,
    do: with({after_it, samples} <- number(bytes), do: samples(samples, group, start + after_it, []))

  defp decode(_group, _other), do: :error

  defp samples("", group, at, samples), do: {:ok, at, Enum.reverse(samples), group}

  defp samples(bytes, group, at, samples) do
    with {number, bytes} <- number(bytes),
         {:ok, name, bytes, group} <- name(number, bytes, group),
         {mask, bytes} when mask < @mode_bit <<< 1 <- number(bytes),
         {:ok, sample, bytes} <- values(@numbers, mask, bytes, Map.get(group.last, number, %Sample{})),
         {:ok, sample, bytes, group} <- word(mask &&& @mode_bit, bytes, sample, group) do
      samples(bytes, %{group | last: Map.put(group.last, number, sample)}, at, [{name, sample} | samples])
    else
      _damaged -> :error
    end
  end

  # Reading has the maps the other way round: names by their numbers.
  defp name(number, bytes, %{vehicles: vehicles} = group) do
    case {vehicles, bytes} do
      {%{^number => name}, _bytes} ->
        {:ok, name, bytes, group}

      {_new, <<size, name::binary-size(size), rest::binary>>}
      when number == map_size(vehicles) and number < @max_vehicles and size in 1..@max_name ->
        {:ok, name, rest, %{group | vehicles: Map.put(vehicles, number, :binary.copy(name))}}

      _damaged ->
        :error
    end
  end

  defp values([], _mask, bytes, sample), do: {:ok, sample, bytes}

  defp values([_same | rest], mask, bytes, sample) when (mask &&& 1) == 0,
    do: values(rest, mask >>> 1, bytes, sample)

  defp values([field | rest], mask, bytes, sample) do
    case number(bytes) do
      {0, bytes} ->
        values(rest, mask >>> 1, bytes, %{sample | field => nil})

      {n, bytes} ->
        values(rest, mask >>> 1, bytes, %{
          sample
          | field => (Map.fetch!(sample, field) || 0) + difference(n - 1)
        })

      :error ->
        :error
    end
  end

  defp difference(n) when (n &&& 1) == 0, do: n >>> 1
  defp difference(n), do: -((n + 1) >>> 1)

  defp word(0, bytes, sample, group), do: {:ok, sample, bytes, group}

  defp word(_bit, bytes, sample, %{modes: modes} = group) do
    case number(bytes) do
      {0, bytes} ->
        {:ok, %{sample | mode: nil}, bytes, group}

      {number, bytes} when is_map_key(modes, number) ->
        {:ok, %{sample | mode: Map.fetch!(modes, number)}, bytes, group}

      {number, <<size, word::binary-size(size), rest::binary>>}
      when number == map_size(modes) + 1 and number <= @max_vehicles and size in 1..@max_word ->
        word = :binary.copy(word)
        {:ok, %{sample | mode: word}, rest, %{group | modes: Map.put(modes, number, word)}}

      _damaged ->
        :error
    end
  end

  # At most 35 bits: no difference needs more.
  defp number(bytes), do: number(bytes, 0, 0)

  defp number(<<1::1, low::7, rest::binary>>, shift, sum) when shift < 28,
    do: number(rest, shift + 7, sum ||| low <<< shift)

  defp number(<<0::1, low::7, rest::binary>>, shift, sum), do: {sum ||| low <<< shift, rest}
  defp number(_bytes, _shift, _sum), do: :error
end
