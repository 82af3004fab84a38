defmodule Aerie.Control.Params.Responder do
  @moduledoc """
  Parameters that ground stations read from the gateway, so that a vehicle is not read once per station. Pure:
  `handle(served, event) -> {served, actions}`.

  A list is served for five seconds after it was read, or after the vehicle's checksum showed that it is still right. The next
  request for the whole list then has it checked or read again. It is invalid as soon as something shows that the vehicle
  may have another value: a PARAM_SET from anybody, a PARAM_VALUE or `_HASH_CHECK` that differs, a reboot. Stations that request all
  parameters while the list is being read wait for that read; if it fails, their requests are forwarded to the vehicle. A request for one
  parameter is forwarded if the list may be out of date.

  Events, with the time `now` in microseconds:

    * `{:station, message, from, now}` - PARAM_REQUEST_LIST, PARAM_REQUEST_READ, PARAM_SET or FILE_TRANSFER_PROTOCOL of a ground station, `from`
      being any term for it
    * `{:vehicle, message, now}` - PARAM_VALUE of the vehicle
    * `{:listed, table, now}`, `{:unlisted, now}` - the requested read succeeded, or failed
    * `{:rebooted, now}`

  Actions:

    * `{:reply, from, messages}` - to the station, in the vehicle's name; for files `MavCodec.Ftp.Packet`s
    * `{:forward, from}` - forward its last request to the vehicle
    * `:fetch` - read the list
  """

  alias Aerie.Control.Params.{FileResponder, Param, Table}
  alias MavCodec.Message.ParamValue
  alias MavCodec.Messages, as: M

  @fresh_us 5_000_000
  @max_waiting 64
  @no_index 65_535
  @hash "_HASH_CHECK"
  # MAV_PARAM_TYPE_UINT32
  @uint32 5

  @enforce_keys [:encoding]
  defstruct [:encoding, :table, :until, :seen, names: {}, indices: %{}, waiting: [], again?: false] ++
              [files: %FileResponder{}, opening: %{}]

  @typedoc "`seen`: values that the vehicle reported while the list is being read, otherwise nil"
  @type t :: %__MODULE__{}
  @type event ::
          {:station, struct(), from :: term(), integer()}
          | {:vehicle, struct(), integer()}
          | {:listed, Table.t(), integer()}
          | {:unlisted | :rebooted, integer()}
  @type action :: {:reply, term(), [struct()]} | {:forward, term()} | :fetch

  @doc "The state before anything is known about the vehicle's parameters."
  @spec new(ParamValue.encoding()) :: t()
  def new(encoding), do: %__MODULE__{encoding: encoding}

  @doc "Whether the list is known to be right."
  @spec fresh?(t(), integer()) :: boolean()
  def fresh?(served, now), do: served.table != nil and now < served.until

  @doc "Handles an event."
  @spec handle(t(), event()) :: {t(), [action()]}
  def handle(served, event)

  def handle(served, {:station, %M.ParamRequestList{}, from, now}) do
    cond do
      fresh?(served, now) -> {served, [{:reply, from, all(served)}]}
      from in served.waiting -> {served, []}
      length(served.waiting) >= @max_waiting -> {served, [{:forward, from}]}
      true -> wait(served, from)
    end
  end

  def handle(served, {:station, %M.ParamRequestRead{} = m, from, now}) do
    with true <- fresh?(served, now),
         %M.ParamValue{} = value <- one(served, m) do
      {served, [{:reply, from, [value]}]}
    else
      _not_known -> {served, [{:forward, from}]}
    end
  end

  def handle(served, {:station, %M.FileTransferProtocol{} = m, from, now}) do
    case FileResponder.request(m) do
      {:open, packet} -> open(%{served | files: FileResponder.ended(served.files, from)}, packet, from, now)
      {:more, packet} -> file(served, packet, from)
      :other -> {served, [{:forward, from}]}
    end
  end

  def handle(served, {:station, %M.ParamSet{param_id: name}, from, _now}) do
    # A list that is being read may be older than this, and the vehicle's answer may be lost.
    seen = served.seen && Map.put(served.seen, if(map_size(served.seen) < Table.max(), do: name), :set)
    {%{stale(served) | seen: seen}, [{:forward, from}]}
  end

  def handle(served, {:listed, table, now}) do
    seen = served.seen || %{}
    differs? = Enum.any?(seen, fn {name, value} -> not same?(table, name, value) end)

    cond do
      # A value that is not a number cannot be served exactly.
      Enum.any?(table.params, fn {_name, param} -> param.value == nil end) -> handle(served, {:unlisted, now})
      differs? and not served.again? -> {%{served | seen: %{}, again?: true}, [:fetch]}
      differs? -> handle(served, {:unlisted, now})
      true -> known(served, table, now)
    end
  end

  def handle(served, {:unlisted, _now}) do
    {%{stale(served) | waiting: [], opening: %{}, seen: nil, again?: false},
     for(from <- served.waiting, do: {:forward, from})}
  end

  def handle(served, {:rebooted, _now}), do: {stale(served), []}

  def handle(served, {:vehicle, %M.ParamValue{param_id: name} = m, now}) do
    case ParamValue.decode(m.param_value, m.param_type, served.encoding) do
      {:ok, value, _exact?} -> {note_value(served, name, value, now), []}
      :error -> {served, []}
    end
  end

  defp note_value(%{table: table} = served, name, value, now) do
    served =
      if served.seen && name != @hash && served.seen[name] != :set,
        do: %{served | seen: Map.put(served.seen, name, value)},
        else: served

    cond do
      table == nil ->
        served

      name == @hash and value == table.hash ->
        if(fresh?(served, now), do: %{served | until: now + @fresh_us}, else: served)

      same?(table, name, value) ->
        served

      true ->
        stale(served)
    end
  end

  # PX4's hash is not a parameter of the list.
  defp same?(table, @hash, value), do: table.hash in [nil, value]

  defp same?(_table, _name, :set), do: false

  defp same?(table, name, value) do
    case table.params do
      %{^name => %{value: known}} -> ParamValue.same?(known, value)
      _unknown -> false
    end
  end

  defp stale(served), do: %{served | table: nil, until: nil, files: FileResponder.stale(served.files)}

  # Stations that ask for the file wait for a reading as those that ask for the list.
  defp open(served, packet, from, now) do
    cond do
      fresh?(served, now) -> opened(served, packet, from)
      from in served.waiting -> {put_in(served.opening[from], packet), []}
      length(served.waiting) >= @max_waiting -> {served, [{:forward, from}]}
      true -> wait(put_in(served.opening[from], packet), from)
    end
  end

  # Only a vehicle that has the file and a checksum of it is spoken for.
  defp opened(%{table: %{file_crc: nil}} = served, _packet, from), do: {served, [{:forward, from}]}

  defp opened(served, packet, from) do
    case FileResponder.open(served.files, from, packet, served.table) do
      {packets, files} -> {%{served | files: files}, [{:reply, from, packets}]}
      :full -> {served, [{:forward, from}]}
    end
  end

  defp file(served, packet, from) do
    if FileResponder.ours?(served.files, from, packet) do
      {packets, files} = FileResponder.more(served.files, from, packet)
      {%{served | files: files}, [{:reply, from, packets}]}
    else
      {served, [{:forward, from}]}
    end
  end

  defp wait(%{waiting: []} = served, from),
    do: {%{served | waiting: [from], seen: %{}, again?: false}, [:fetch]}

  defp wait(served, from), do: {%{served | waiting: served.waiting ++ [from]}, []}

  defp known(served, table, now) do
    names = List.to_tuple(table.order)
    indices = table.order |> Enum.with_index() |> Map.new()
    {waiting, opening} = {served.waiting, served.opening}

    served = %{
      served
      | table: table,
        until: now + @fresh_us,
        names: names,
        indices: indices,
        waiting: [],
        opening: %{},
        seen: nil,
        again?: false
    }

    messages = if waiting != [], do: all(served)

    Enum.reduce(waiting, {served, []}, fn from, {served, actions} ->
      {served, more} =
        case opening do
          %{^from => packet} -> opened(served, packet, from)
          _list -> {served, [{:reply, from, messages}]}
        end

      {served, actions ++ more}
    end)
  end

  # --- Messages

  # PX4 sends its hash first.
  defp all(served) do
    hash = if served.table.hash, do: [hash(served)], else: []
    hash ++ for({name, index} <- Enum.with_index(served.table.order), do: message(served, name, index))
  end

  defp one(%{table: %{hash: hash}} = served, %{param_index: -1, param_id: @hash}) when hash != nil,
    do: hash(served)

  defp one(served, %{param_index: -1, param_id: name}),
    do: if(is_map_key(served.indices, name), do: message(served, name, served.indices[name]))

  defp one(%{names: names} = served, %{param_index: index}) when index >= 0 and index < tuple_size(names),
    do: message(served, elem(names, index), index)

  defp one(_served, _unknown), do: nil

  defp message(served, name, index) do
    %Param{value: value, type: type} = Map.fetch!(served.table.params, name)

    %M.ParamValue{
      param_id: name,
      param_value: wire(value, type, served.encoding),
      param_type: type,
      param_count: tuple_size(served.names),
      param_index: index
    }
  end

  # A value that loses bits in a float loses them when the vehicle sends it, too.
  defp wire(value, type, encoding) do
    case ParamValue.encode(value, type, encoding) do
      {:ok, wire} -> wire
      {:error, _inexact} -> ParamValue.float32(value)
    end
  end

  defp hash(served) do
    {:ok, wire} = ParamValue.encode(served.table.hash, @uint32, served.encoding)

    %M.ParamValue{
      param_id: @hash,
      param_value: wire,
      param_type: @uint32,
      param_count: tuple_size(served.names),
      param_index: @no_index
    }
  end
end
