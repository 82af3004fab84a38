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

  alias Aerie.Control.Params.{Param, Table}
  alias Aerie.Control.Params.Responder.Files
  alias MavCodec.Message.ParamValue
  alias MavCodec.Messages, as: M
  alias Protocols.Params.Listing

  @fresh_us 5_000_000
  @max_waiting 64
  @hash Listing.hash()

  @enforce_keys [:listing]
  defstruct [
    :listing,
    :table,
    :until,
    :seen,
    waiting: [],
    again?: false,
    files: %Files{},
    opening: %{}
  ]

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
  def new(encoding), do: %__MODULE__{listing: Listing.new([], encoding)}

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
    case Files.request(m) do
      {:open, packet} -> open(%{served | files: Files.ended(served.files, from)}, packet, from, now)
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
    case ParamValue.decode(m.param_value, m.param_type, served.listing.encoding) do
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

  defp stale(served), do: %{served | table: nil, until: nil, files: Files.stale(served.files)}

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
    case Files.open(served.files, from, packet, served.table) do
      {packets, files} -> {%{served | files: files}, [{:reply, from, packets}]}
      :full -> {served, [{:forward, from}]}
    end
  end

  defp file(served, packet, from) do
    if Files.ours?(served.files, from, packet) do
      {packets, files} = Files.more(served.files, from, packet)
      {%{served | files: files}, [{:reply, from, packets}]}
    else
      {served, [{:forward, from}]}
    end
  end

  defp wait(%{waiting: []} = served, from),
    do: {%{served | waiting: [from], seen: %{}, again?: false}, [:fetch]}

  defp wait(served, from), do: {%{served | waiting: served.waiting ++ [from]}, []}

  defp known(served, table, now) do
    {waiting, opening} = {served.waiting, served.opening}

    served = %{
      served
      | table: table,
        until: now + @fresh_us,
        listing: Listing.new(table.order, served.listing.encoding),
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
    hash = if served.table.hash, do: [Listing.hash(served.listing, served.table.hash)], else: []
    hash ++ Enum.map(served.table.order, &message(served, &1))
  end

  defp one(%{table: %{hash: hash}} = served, %{param_index: -1, param_id: @hash}) when hash != nil,
    do: Listing.hash(served.listing, hash)

  defp one(served, request),
    do: with(name when name != nil <- Listing.wanted(served.listing, request), do: message(served, name))

  defp message(served, name) do
    %Param{value: value, type: type} = Map.fetch!(served.table.params, name)
    Listing.value(served.listing, name, value, type)
  end
end
