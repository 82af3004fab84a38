defmodule Msp.Session.Missions do
  @patience_us 5_000_000
  @again_us 700_000

  @moduledoc """
  The mission protocol of MAVLink for iNav, over WP, SET_WP and WP_GETINFO. Betaflight has no missions in MSP.

  iNav acknowledges waypoints that it ignores, so a mission is there only if WP_GETINFO says that it is valid and each waypoint reads as
  it was written. One that was accepted is lost with the next restart unless it is stored (PREFLIGHT_STORAGE with 1 in parameter 2). MSP has no
  message that removes a mission, and while a vehicle is armed none is written.

  An upload ends if no item comes for #{div(@patience_us, 1_000_000)} s. While waypoints are written, which takes seconds on a slow line, the
  last item is requested again every #{div(@again_us, 1000)} ms, so that the client waits.
  """
  @behaviour Msp.Session.Tasks

  alias MavCodec.Messages, as: M
  alias Msp.{Firmware, Mission, Session}
  alias Msp.Session.{Output, Tasks}
  alias Msp.Session.Tasks.Armed
  alias Protocols.Mission.{Reply, Upload}

  defstruct [:aboard, :upload, :last]

  @typedoc """
  - `aboard`: the waypoints and items of the vehicle's mission, nil until they were read
  - `upload`: the one that a client writes; `last`: who wrote the last one, and what came of it
  """
  @type t :: %__MODULE__{}

  @handled [
    M.MissionRequestList,
    M.MissionRequestInt,
    M.MissionRequest,
    M.MissionCount,
    M.MissionItemInt,
    M.MissionClearAll,
    M.MissionAck
  ]
  @ids Enum.map(@handled, & &1.id())
  @mission 0
  @cancelled Reply.result(:OPERATION_CANCELLED)
  @notice 5
  # After the first time. A waypoint that is written again is ignored, as its number is not the next one.
  @tries 2
  # Speeds and user actions are items of their own.
  @most_items 3 * Mission.most()
  @rules %{again_us: @again_us, patience_us: @patience_us, out_of_turn: :ask}

  @doc "Whether this is a message of the mission protocol."
  @spec mine?(non_neg_integer) :: boolean
  def mine?(id), do: id in @ids

  @doc "A message of a client."
  @spec message(Session.t(), struct, from :: {byte, byte}, integer) :: Session.t()
  def message(
        %{system: system} = session,
        %{target_system: system, target_component: component} = message,
        from,
        now
      )
      when component in [0, 1] do
    cond do
      is_struct(message, M.MissionAck) and message.type == @cancelled ->
        upload(session, {:cancelled, from}, now)

      is_struct(message, M.MissionAck) ->
        session

      not Firmware.of(session.identity.firmware).missions? ->
        acknowledge(session, message, from, :UNSUPPORTED)

      message.mission_type != @mission ->
        other(session, message, from)

      true ->
        handle(session, message, from, now)
    end
  end

  def message(session, _for_another, _from, _now), do: session

  # What iNav does not have is empty.
  defp other(session, %M.MissionRequestList{} = message, from),
    do: count(session, 0, message.mission_type, from)

  defp other(session, message, from), do: acknowledge(session, message, from, :UNSUPPORTED)

  defp handle(session, %M.MissionRequestList{}, from, _now) do
    cond do
      Tasks.any?(session, &match?(%{kind: __MODULE__, what: :read, from: ^from}, &1)) -> session
      not Tasks.room?(session) -> session
      true -> Tasks.add(session, reading(:read, from))
    end
  end

  defp handle(session, %module{seq: seq} = message, from, _now)
       when module in [M.MissionRequestInt, M.MissionRequest] do
    {system, component} = from

    aboard = session.missions.aboard

    case aboard && Enum.at(aboard.items, seq) do
      nil -> acknowledge(session, message, from, if(aboard, do: :INVALID_SEQUENCE, else: :ERROR))
      item -> Output.emit(session, %{item | target_system: system, target_component: component})
    end
  end

  defp handle(session, %M.MissionCount{count: count} = message, from, now) do
    cond do
      why = refusal(session, from, now) ->
        session |> Output.text(@notice, "Mission not written: #{why}") |> acknowledge(message, from, :DENIED)

      count == 0 ->
        handle(session, %M.MissionClearAll{mission_type: @mission}, from, now)

      count > @most_items ->
        acknowledge(session, message, from, :NO_SPACE)

      true ->
        upload(session, {:count, message, from}, now)
    end
  end

  # The client repeats the last item, as it did not see what came of it.
  defp handle(
         %{missions: %{upload: nil, last: {from, result}}} = session,
         %M.MissionItemInt{} = item,
         from,
         _
       ),
       do: acknowledge(session, item, from, result)

  defp handle(session, %M.MissionItemInt{} = item, from, now), do: upload(session, {:item, item, from}, now)

  defp handle(session, %M.MissionClearAll{} = message, from, _now) do
    session
    |> Output.text(@notice, "MSP has no message that removes iNav's mission: write another one")
    |> acknowledge(message, from, :UNSUPPORTED)
  end

  defp refusal(%{missions: %{upload: upload}} = session, from, now) do
    busy = Upload.busy(upload, from, @rules, now)

    cond do
      Armed.early(session) != nil -> Armed.early(session)
      busy == :storing -> "another one is being written"
      busy == :other -> "another client writes one"
      upload == nil and not Tasks.room?(session) -> "it is busy"
      true -> nil
    end
  end

  defp upload(session, event, now) do
    {upload, actions} = Upload.handle(session.missions.upload, event, @rules, now)
    Enum.reduce(actions, put_in(session.missions.upload, upload), &act(&2, &1, event))
  end

  defp act(session, {:send, message}, _event), do: Output.emit(session, message)
  defp act(session, {:store, items}, _event), do: complete(session, items)
  defp act(session, :stray, {:item, item, from}), do: acknowledge(session, item, from, :INVALID_SEQUENCE)

  defp complete(%{missions: %{upload: %{from: from}}} = session, items) do
    # It may have been armed since.
    with {:armed, nil} <- {:armed, Armed.early(session)},
         {:ok, [first | rest] = waypoints} <- Mission.waypoints(items) do
      task = %{kind: __MODULE__, what: :write, from: from, tries: 0, waypoints: waypoints, rest: rest, at: 1}
      session |> forget() |> Tasks.add(Map.put(task, :ask, {"SET_WP", first}))
    else
      {:armed, why} -> ended(session, from, :DENIED, why)
      {:error, {:unsupported, why}} -> ended(session, from, :UNSUPPORTED, why)
      {:error, {:frame, why}} -> ended(session, from, :UNSUPPORTED_FRAME, why)
      {:error, {:invalid, why}} -> ended(session, from, :INVALID, why)
    end
  end

  defp reading(what, from),
    do: %{kind: __MODULE__, what: what, from: from, tries: 0, ask: {"WP_GETINFO", %{}}, read: [], count: nil}

  @doc "What is due: requests that are repeated, and the end of an upload whose client fell silent."
  @spec due(Session.t(), integer) :: Session.t()
  def due(session, now), do: upload(session, :tick, now)

  @doc "Whether a client writes one."
  @spec uploading?(Session.t()) :: boolean
  def uploading?(%{missions: %{upload: upload}}), do: upload != nil

  @doc "The mission aboard is not known any more."
  @spec forget(Session.t()) :: Session.t()
  def forget(session), do: put_in(session.missions.aboard, nil)

  @doc "How many waypoints the vehicle has: with another number another program, or the pilot, has changed its mission."
  @spec counted(Session.t(), non_neg_integer) :: Session.t()
  def counted(%{missions: %{aboard: %{waypoints: known}}} = session, count) when length(known) != count,
    do: forget(session)

  def counted(session, _count), do: session

  @doc "The vehicle is asked again who it is. What came of the last upload stays."
  @spec interrupted(Session.t()) :: Session.t()
  def interrupted(session), do: %{session | missions: %__MODULE__{last: session.missions.last}}

  @impl Tasks
  def answer(session, %{tries: tries} = task, :timeout, _now) when tries < @tries,
    do: Tasks.ask_next(session, task, %{tries: tries + 1})

  def answer(session, task, answer, _now), do: step(session, %{task | tries: 0}, answer)

  # --- written, then read ---

  defp step(session, %{what: :write, rest: [next | rest]} = task, {:ok, _acknowledged}),
    do: Tasks.ask_next(session, task, %{rest: rest, tries: 0, at: task.at + 1, ask: {"SET_WP", next}})

  defp step(session, %{what: :write, rest: []} = task, {:ok, _acknowledged}),
    do: Tasks.ask_next(session, task, Map.merge(reading(:check, task.from), %{tries: 0}))

  defp step(session, %{what: :write, at: 1} = task, {:denied, why}),
    do: session |> Tasks.done(task) |> ended(task.from, :DENIED, why)

  defp step(session, %{what: :write} = task, answer),
    do:
      failed(
        session,
        task,
        "waypoint #{task.at} #{why(answer)}; a part of the mission is aboard, and iNav does not fly it"
      )

  defp step(session, %{ask: {"WP_GETINFO", _}} = task, {:ok, %{count: count} = info}) do
    task = Map.merge(task, %{count: count, valid: info.valid == 1})

    cond do
      task.what == :check and count != length(task.waypoints) ->
        failed(session, task, "#{count} of #{length(task.waypoints)} waypoints were taken")

      task.what == :check and not task.valid ->
        failed(session, task, "iNav calls the mission invalid")

      count == 0 ->
        read(session, task, [])

      true ->
        Tasks.ask_next(session, task, %{count: count, valid: task.valid, tries: 0, ask: {"WP", %{number: 1}}})
    end
  end

  defp step(session, %{ask: {"WP", %{number: number}}} = task, {:ok, %{number: number} = waypoint}) do
    read = [waypoint | task.read]

    if number < task.count,
      do: Tasks.ask_next(session, task, %{read: read, tries: 0, ask: {"WP", %{number: number + 1}}}),
      else: read(session, task, Enum.reverse(read))
  end

  defp step(session, %{what: :check} = task, answer),
    do: failed(session, task, "it was written, but reading it #{why(answer)}")

  defp step(session, task, answer) do
    session
    |> Tasks.done(task)
    |> acknowledge(@mission, task.from, :ERROR)
    |> Output.text(@notice, "Mission not read: the flight controller #{why(answer)}")
  end

  defp read(session, %{what: :check} = task, waypoints) do
    case Enum.find(Enum.zip(task.waypoints, waypoints), fn {a, b} -> not Mission.same?(a, b) end) do
      nil ->
        {:ok, items} = Mission.items(task.waypoints)

        session
        |> aboard(task.waypoints, items)
        |> Tasks.done(task)
        |> ended(task.from, :ACCEPTED, nil)
        |> Output.text(
          @notice,
          "Mission of #{length(waypoints)} waypoints not stored yet: the next restart forgets it"
        )

      {written, _read} ->
        failed(session, task, "waypoint #{written.number} is not as it was written")
    end
  end

  defp read(session, task, waypoints) do
    session = Tasks.done(session, task)

    case Mission.items(waypoints) do
      {:ok, items} ->
        session |> aboard(waypoints, items) |> count(length(items), @mission, task.from)

      {:error, why} ->
        session
        |> acknowledge(@mission, task.from, :ERROR)
        |> Output.text(@notice, "Mission not read: #{why}")
    end
  end

  defp aboard(session, waypoints, items),
    do: put_in(session.missions.aboard, %{waypoints: waypoints, items: items})

  defp why(:timeout), do: "was not answered"
  defp why(:refused), do: "was refused"
  defp why({:denied, why}), do: "was not written: #{why}"
  defp why({:unfit, why}), do: "cannot be sent: #{why}"
  defp why(_other), do: "got another answer"

  defp failed(session, task, why), do: session |> Tasks.done(task) |> ended(task.from, :ERROR, why)

  defp ended(session, from, result, why) do
    session = if why, do: Output.text(session, @notice, "Mission not written: #{why}"), else: session
    missions = %{session.missions | upload: nil, last: {from, result}}
    acknowledge(%{session | missions: missions}, @mission, from, result)
  end

  defp count(session, count, type, from), do: Output.emit(session, Reply.count(type, count, from))

  defp acknowledge(session, %{mission_type: type}, from, result), do: acknowledge(session, type, from, result)
  defp acknowledge(session, type, from, result), do: Output.emit(session, Reply.ack(type, result, from))
end
