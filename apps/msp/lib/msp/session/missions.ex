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

  alias MavCodec.Enums.MavMissionResult
  alias MavCodec.Messages, as: M
  alias Msp.{Mission, Session}
  alias Msp.Session.{Output, Tasks}
  alias Msp.Session.Tasks.Armed

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
  @results Map.new(
             ~w(ACCEPTED ERROR UNSUPPORTED UNSUPPORTED_FRAME NO_SPACE INVALID INVALID_SEQUENCE DENIED OPERATION_CANCELLED)a,
             &{&1, MavMissionResult.value(:"MAV_MISSION_#{&1}")}
           )
  @mission 0
  @notice 5
  # After the first time. A waypoint that is written again is ignored, as its number is not the next one.
  @tries 2
  # Speeds and user actions are items of their own.
  @most_items 3 * Mission.most()

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
      is_struct(message, M.MissionAck) -> cancelled(session, message, from)
      session.identity.firmware != :inav -> acknowledge(session, message, from, :UNSUPPORTED)
      message.mission_type != @mission -> other(session, message, from)
      true -> handle(session, message, from, now)
    end
  end

  def message(session, _for_another, _from, _now), do: session

  # What iNav does not have is empty.
  defp other(session, %M.MissionRequestList{} = message, from),
    do: count(session, 0, message.mission_type, from)

  defp other(session, message, from), do: acknowledge(session, message, from, :UNSUPPORTED)

  defp handle(session, %M.MissionRequestList{}, from, _now) do
    cond do
      Enum.any?(session.tasks, &match?(%{kind: __MODULE__, what: :read, from: ^from}, &1)) -> session
      not Tasks.room?(session) -> session
      true -> Tasks.add(session, reading(:read, from))
    end
  end

  defp handle(session, %module{seq: seq} = message, from, _now)
       when module in [M.MissionRequestInt, M.MissionRequest] do
    {system, component} = from

    case session.mission && Enum.at(session.mission.items, seq) do
      nil -> acknowledge(session, message, from, if(session.mission, do: :INVALID_SEQUENCE, else: :ERROR))
      item -> Output.emit(session, %{item | target_system: system, target_component: component})
    end
  end

  defp handle(session, %M.MissionCount{count: count} = message, from, now) do
    cond do
      refusal = refusal(session, from, now) ->
        {result, why} = refusal
        session |> Output.text(@notice, "Mission not written: #{why}") |> acknowledge(message, from, result)

      count == 0 ->
        handle(session, %M.MissionClearAll{mission_type: @mission}, from, now)

      count > @most_items ->
        acknowledge(session, message, from, :NO_SPACE)

      true ->
        request(%{session | upload: %{from: from, count: count, items: [], at: now, told: now}}, 0)
    end
  end

  defp handle(
         %{upload: %{from: from, items: items, count: count} = upload} = session,
         %M.MissionItemInt{seq: seq} = item,
         from,
         now
       )
       when is_list(items) do
    cond do
      seq != length(items) ->
        request(session, length(items))

      seq + 1 == count ->
        complete(%{session | upload: %{upload | items: :writing}}, Enum.reverse([item | items]), now)

      true ->
        request(%{session | upload: %{upload | items: [item | items], at: now}}, seq + 1)
    end
  end

  # The client repeats the last item, as it did not see what came of it.
  defp handle(%{uploaded: {from, result}, upload: nil} = session, %M.MissionItemInt{} = item, from, _now),
    do: acknowledge(session, item, from, result)

  defp handle(session, %M.MissionItemInt{} = item, from, _now) do
    if session.upload && session.upload.from == from,
      do: session,
      else: acknowledge(session, item, from, :INVALID_SEQUENCE)
  end

  defp handle(session, %M.MissionClearAll{} = message, from, _now) do
    session
    |> Output.text(@notice, "MSP has no message that removes iNav's mission: write another one")
    |> acknowledge(message, from, :UNSUPPORTED)
  end

  defp refusal(session, from, now) do
    cond do
      Armed.early(session) != nil -> {:DENIED, Armed.early(session)}
      session.upload == nil -> if(not Tasks.room?(session), do: {:DENIED, "it is busy"})
      session.upload.items == :writing -> {:DENIED, "another one is being written"}
      # One that its client has given up.
      session.upload.from == from or now - session.upload.at > @patience_us -> nil
      true -> {:DENIED, "another client writes one"}
    end
  end

  defp cancelled(%{upload: %{from: from, items: items}} = session, %{type: type}, from) when is_list(items) do
    if type == @results[:OPERATION_CANCELLED], do: %{session | upload: nil}, else: session
  end

  defp cancelled(session, _ack, _from), do: session

  defp complete(%{upload: %{from: from}} = session, items, now) do
    # It may have been armed since.
    with {:armed, nil} <- {:armed, Armed.early(session)},
         {:ok, [first | rest] = waypoints} <- Mission.waypoints(items) do
      task = %{kind: __MODULE__, what: :write, from: from, tries: 0, waypoints: waypoints, rest: rest, at: 1}

      Tasks.add(
        %{session | mission: nil, upload: %{session.upload | at: now, told: now}},
        Map.put(task, :ask, {"SET_WP", first})
      )
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
  def due(%{upload: %{told: told, at: at} = upload} = session, now) when now - told > @again_us do
    session = %{session | upload: %{upload | told: now}}

    case upload.items do
      :writing -> request(session, upload.count - 1)
      items when now - at <= @patience_us -> request(session, length(items))
      _silent -> acknowledge(%{session | upload: nil}, @mission, upload.from, :OPERATION_CANCELLED)
    end
  end

  def due(session, _now), do: session

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

        %{session | mission: %{waypoints: task.waypoints, items: items}}
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
        count(%{session | mission: %{waypoints: waypoints, items: items}}, length(items), @mission, task.from)

      {:error, why} ->
        session
        |> acknowledge(@mission, task.from, :ERROR)
        |> Output.text(@notice, "Mission not read: #{why}")
    end
  end

  defp why(:timeout), do: "was not answered"
  defp why(:refused), do: "was refused"
  defp why({:denied, why}), do: "was not written: #{why}"
  defp why({:unfit, why}), do: "cannot be sent: #{why}"
  defp why(_other), do: "got another answer"

  defp failed(session, task, why), do: session |> Tasks.done(task) |> ended(task.from, :ERROR, why)

  defp ended(session, from, result, why) do
    session = if why, do: Output.text(session, @notice, "Mission not written: #{why}"), else: session
    acknowledge(%{session | upload: nil, uploaded: {from, result}}, @mission, from, result)
  end

  # --- messages ---

  defp request(%{upload: %{from: {system, component}}} = session, seq) do
    Output.emit(session, %M.MissionRequestInt{
      target_system: system,
      target_component: component,
      seq: seq,
      mission_type: @mission
    })
  end

  defp count(session, count, type, {system, component}) do
    Output.emit(session, %M.MissionCount{
      target_system: system,
      target_component: component,
      count: count,
      mission_type: type
    })
  end

  defp acknowledge(session, %{mission_type: type}, from, result), do: acknowledge(session, type, from, result)

  defp acknowledge(session, type, {system, component}, result) do
    Output.emit(session, %M.MissionAck{
      target_system: system,
      target_component: component,
      type: Map.fetch!(@results, result),
      mission_type: type
    })
  end
end
