defmodule SimVehicle.Services.Requests do
  @moduledoc """
  The requests that both firmwares understand, apart from result codes: message intervals, single messages, parameters,
  time. The codes are given by the personality that calls.
  """

  alias MavCodec.Enums.MavResult
  alias MavCodec.Messages, as: M
  alias Protocols.Params.Listing
  alias SimVehicle.{Params, Vehicle}
  alias SimVehicle.Services.{Command, Streams}

  @failed MavResult.value(:MAV_RESULT_FAILED)
  # The largest value of MESSAGE_INTERVAL: 35 minutes.
  @interval_max_us 2_147_483_647
  @accepted MavResult.value(:MAV_RESULT_ACCEPTED)

  @doc "SET_MESSAGE_INTERVAL (511); `known` are the ids that the firmware can stream."
  @spec set_interval(Vehicle.t(), Command.t(), [non_neg_integer]) :: Vehicle.t()
  def set_interval(v, command, known) do
    id = trunc(Command.p(command, 1))
    interval = Command.p(command, 2)

    if id in known and interval >= -1 do
      streams =
        Streams.set(v.streams, id, if(interval < 0, do: -1, else: round(min(interval, @interval_max_us))))

      Vehicle.ack(%{v | streams: streams}, command, @accepted)
    else
      Vehicle.ack(v, command, @failed)
    end
  end

  @doc "MESSAGE_INTERVAL, the answer to GET_MESSAGE_INTERVAL (510); 0 for a message that the firmware does not have."
  @spec interval(Vehicle.t(), Command.t(), [non_neg_integer]) :: struct
  def interval(v, command, known) do
    id = command |> Command.p(1) |> trunc() |> max(0) |> min(65_535)

    %M.MessageInterval{
      message_id: id,
      interval_us: if(id in known, do: Streams.interval_us(v.streams, id), else: 0)
    }
  end

  @doc "REQUEST_DATA_STREAM: sets the rate of a group of messages."
  @spec data_stream(Vehicle.t(), struct, %{non_neg_integer => [non_neg_integer]}) :: Vehicle.t()
  def data_stream(v, m, groups) do
    ids =
      if m.req_stream_id == 0,
        do: Enum.flat_map(groups, &elem(&1, 1)),
        else: Map.get(groups, m.req_stream_id, [])

    hz = if m.start_stop == 1, do: min(m.req_message_rate, 50), else: 0
    %{v | streams: Streams.set_rate(ids, v.streams, hz)}
  end

  @doc "PARAM_VALUE of a name; `index` as the firmware gives it in this answer."
  @spec param_value(Vehicle.t(), String.t(), 0..65_535 | nil) :: struct
  def param_value(v, name, index \\ nil) do
    message = Params.message(v.params, name)
    if index, do: %{message | param_index: index}, else: message
  end

  @doc "The name that a PARAM_REQUEST_READ asks for, or nil if there is none."
  @spec wanted_param(Vehicle.t(), struct) :: String.t() | nil
  def wanted_param(v, request), do: Listing.wanted(v.params.listing, request)

  @doc "PARAM_REQUEST_LIST: the list is sent from now on, `first` before it, `per_s` parameters a second (P4)."
  @spec list_params(Vehicle.t(), [String.t()], pos_integer) :: Vehicle.t()
  def list_params(v, first, per_s) do
    v = Enum.reduce(first, v, &Vehicle.emit(&2, Params.message(&2.params, &1)))
    Vehicle.put_own(v, :param_list, {0, v.now, per_s})
  end

  @doc "Sends what of the list is due."
  @spec tick_params(Vehicle.t()) :: Vehicle.t()
  def tick_params(v) do
    case Vehicle.own(v, :param_list) do
      nil ->
        v

      {next, since, per_s} ->
        listing = v.params.listing
        count = Listing.count(listing)
        due = min(div((v.now - since) * per_s, 1_000_000), count)
        names = for n <- next..(due - 1)//1, do: Listing.at(listing, n)
        v = Enum.reduce(names, v, &Vehicle.emit(&2, Params.message(&2.params, &1)))
        Vehicle.put_own(v, :param_list, if(due < count, do: {due, since, per_s}))
    end
  end

  @doc "Stores the value of a PARAM_SET and applies it."
  @spec set_param(Vehicle.t(), struct) :: {:ok, Vehicle.t()} | {:error, atom}
  def set_param(v, %M.ParamSet{} = m) do
    with {:ok, params} <- Params.set(v.params, m.param_id, m.param_value, m.param_type) do
      v = %{v | params: params, limits: v.personality.limits(params)}
      {:ok, Vehicle.notify(v, {:param, m.param_id, Params.get(params, m.param_id)})}
    end
  end

  @doc "Answers a TIMESYNC request (X5). An answer is ignored."
  @spec timesync(Vehicle.t(), struct, {integer, integer}) :: Vehicle.t()
  def timesync(v, %M.Timesync{tc1: 0} = m, {system, component}) do
    answer = %M.Timesync{tc1: v.now * 1000, ts1: m.ts1, target_system: system, target_component: component}
    Vehicle.emit(v, answer)
  end

  def timesync(v, _answer, _source), do: v
end
