defmodule Aerie.Control.CommandExecutor.Steps do
  @moduledoc """
  The steps of the commands in `Aerie.Control.CommandExecutor.Core`: their turns, sending, answers, time and ends. Pure; each function
  takes and gives the core with the actions so far, the latest first.
  """

  alias Aerie.Vehicle.Command.{Refusal, Result}
  alias Aerie.Vehicle.Protocol
  alias Aerie.Vehicle.Protocol.Mavlink.Version
  alias Aerie.Control.CommandExecutor.{Core, Ending, Job, Repeater, Timing, Turns, Verdict}

  # Results that the vehicle's own words may explain.
  @explained [:rejected, :failed, :timeout, :unknown]
  # Time that comes in a larger jump than this is time in which the gateway, or its machine, stood still.
  @stall 100_000
  @longest_stall 2_000_000

  # --- Turns: what waits for its lane and may be sent now

  @doc "Sends what has its turn now."
  @spec turns(Core.acc(), now :: integer()) :: Core.acc()
  def turns({core, actions} = acc, now) do
    case Turns.next(core.lanes, now) do
      {id, lanes} -> {%{core | lanes: lanes}, actions} |> turn(Map.fetch!(core.jobs, id), now) |> turns(now)
      nil -> let_go(acc, now)
    end
  end

  # The session may ask again as soon as no answer to us can come any more.
  defp let_go({%{alone: :held} = core, actions} = acc, now) do
    busy? = Enum.any?(core.jobs, fn {_id, job} -> Job.step(job).shared? and job.phase != :queued end)

    cond do
      busy? -> {%{core | alone_until: nil}, actions}
      core.alone_until == nil -> {%{core | alone_until: now + Timing.busy(core.rtt)}, actions}
      now < core.alone_until -> acc
      true -> {%{core | alone: :no, alone_until: nil}, [{:alone, false} | actions]}
    end
  end

  defp let_go(acc, _now), do: acc

  @doc "The session asks nothing any more: what waited for that is sent."
  @spec alone(Core.acc(), now :: integer()) :: Core.acc()
  def alone(acc, now), do: each(acc, &(&1.phase == :turn), &transmit(&1, &2, now))

  defp turn({core, _actions} = acc, job, now) do
    cond do
      now >= job.until -> finish(acc, job, expired(job), now)
      # While it waited the vehicle may have changed its mode.
      job.done == 0 -> plan_again(acc, job, Protocol.plan(core.protocol, job.command, core.vehicle), now)
      true -> transmit(acc, job, now)
    end
  end

  defp plan_again({core, actions} = acc, job, {:ok, steps}, now) do
    key = Job.key(job)
    job = %{job | steps: steps}

    if Job.key(job) == key do
      transmit(acc, job, now)
    else
      lanes = core.lanes |> Turns.leave(key, Job.id(job), now) |> Turns.push(Job.key(job), Job.id(job))
      {put(%{core | lanes: lanes}, job), actions}
    end
  end

  defp plan_again(acc, job, {_gap_or_error, reason}, now), do: finish(acc, job, {:rejected, reason}, now)

  defp expired(%{done: 0}), do: Refusal.ended(:expired_waiting)
  defp expired(job), do: Refusal.ended(:expired_between, done: job.done)

  # --- Sending

  defp transmit({%{alone: alone} = core, actions}, %{steps: [%{shared?: true} | _later]} = job, _now)
       when alone != :held do
    job = %{job | phase: :turn, due: job.until}
    ask = if alone == :no, do: [{:alone, true}], else: []
    {put(%{core | alone: :asked}, job), ask ++ actions}
  end

  defp transmit({core, _actions} = acc, job, now) do
    messages = core.protocol.encode(Job.step(job), job.sends, core.vehicle)

    case Version.refusal(messages, core.vehicle.version) do
      reason when reason != nil and job.sends == 0 -> finish(acc, job, {:rejected, reason}, now)
      _sayable_or_sent_before -> transmit(acc, job, messages, now)
    end
  end

  defp transmit({core, actions}, job, messages, now) do
    step = Job.step(job)
    job = Job.sent(job, core.vehicle, now, now + patience(core, job, now))
    job = %{job | ambiguous?: job.ambiguous? or Ending.mistakable?(core.jobs, core.lanes, step, now)}
    {job, jobs} = Job.doubt(job, Ending.begun(core.jobs, step, now))

    acc =
      {put(%{core | jobs: jobs}, job), [{:send, messages, Job.id(job)} | actions]}

    # Nothing will ever be heard of it.
    if step.acked? or step.confirm != nil, do: acc, else: step_done(acc, job, :accepted, nil, now)
  end

  defp patience(%{rtt: rtt}, job, now) do
    %{repeat: repeat, answer_ms: ms} = Job.step(job)
    answer = Timing.answer(rtt, ms * 1000)
    last? = job.sends + 1 >= Timing.sends(rtt) or now + answer >= job.until

    if repeat == :safe and not (rtt == :high_latency and last?),
      do: answer,
      else: Timing.only_answer(rtt, ms * 1000)
  end

  # --- Answers

  @doc "Applies a message to a job."
  @spec answer(Core.acc(), Job.t(), Protocol.answer(), now :: integer()) :: Core.acc()
  def answer(acc, _job, :ignore, _now), do: acc
  # Late answers to a form that is given up.
  def answer(acc, %{phase: :instead}, _answer, _now), do: acc
  def answer(acc, %{phase: :refused}, _answer, _now), do: acc
  # It may be the other command that is to be said otherwise, and this one is being done.
  def answer(acc, %{ambiguous?: true}, {:instead, _step}, _now), do: acc

  # Or what cancels it: whether that is refused does not matter.
  def answer(acc, %{phase: :cancelling, ambiguous?: true}, {:busy, _reason}, _now), do: acc
  def answer(acc, %{phase: :cancelling, ambiguous?: true}, {:refused, _status, _reason}, _now), do: acc

  def answer(acc, %{accepted_at: nil} = job, :accepted, now) do
    case Job.step(job) do
      %{confirm: nil} when job.ambiguous? ->
        finish(acc, %{job | accepted_at: now}, Refusal.ended(:ambiguous), now)

      %{confirm: nil} ->
        step_done(acc, %{job | accepted_at: now}, :accepted, nil, now)

      step ->
        acc = busy_with(acc, step.holds)
        phase = if job.phase == :cancelling, do: :cancelling, else: :accepted
        due = if phase == :cancelling, do: job.due, else: now + step.within_ms * 1000
        job = %{job | phase: phase, accepted_at: now, due: due}
        acc |> keep(job) |> observe(job, now)
    end
  end

  def answer(acc, _job, :accepted, _now), do: acc

  def answer(acc, %{ambiguous?: true}, {:accepted, _reason}, _now), do: acc

  def answer(acc, job, {:accepted, reason}, now),
    do: step_done(acc, %{job | accepted_at: now}, :accepted, reason, now)

  def answer({core, actions}, job, {:progress, share, text}, now) do
    progress = {:progress, Job.id(job), %{"progress" => share, "text" => text}}

    job =
      case job.phase do
        :cancelling -> job
        :accepted -> %{job | due: now + Job.step(job).within_ms * 1000}
        _running -> %{job | phase: :running, due: now + Timing.progress(core.rtt)}
      end

    {put(core, job), [progress | actions]}
  end

  def answer({core, _actions} = acc, job, {:busy, _reason} = refusal, now)
      when job.sends > 1 or job.ambiguous?,
      do: refused(acc, job, refusal, Timing.busy(core.rtt), now)

  def answer(acc, job, {:busy, reason}, now), do: explain(acc, job, {:rejected, reason}, now)

  def answer(acc, job, {:refused, status, reason}, now) do
    cond do
      (job.sends > 1 or job.ambiguous?) and Verdict.observable?(job) ->
        refused(acc, job, {status, reason}, 0, now)

      job.ambiguous? ->
        finish(acc, job, Refusal.ended(:ambiguous), now)

      true ->
        explain(acc, job, {status, reason}, now)
    end
  end

  def answer(acc, job, {:failed, reason}, now), do: acc |> idle(job) |> finish(job, {:failed, reason}, now)

  def answer(acc, job, :cancelled, now),
    do: acc |> idle(job) |> finish(job, Refusal.ended(:cancelled_vehicle), now)

  def answer(acc, job, :done, now), do: acc |> idle(job) |> step_done(job, :completed, nil, now)

  def answer({core, _actions} = acc, job, {:instead, step}, now) do
    steps = [%{step | repeat: Job.step(job).repeat} | tl(job.steps)]
    keep(acc, %{job | phase: :instead, steps: steps, due: now + Timing.quiet(core.rtt)})
  end

  defp busy_with(acc, nil), do: acc
  defp busy_with({core, actions}, what), do: {put_in(core.vehicle.busy_with, what), actions}

  defp idle(acc, %{steps: [%{holds: nil} | _others]}), do: acc
  defp idle({core, actions}, _job), do: {put_in(core.vehicle.busy_with, nil), actions}

  # ArduPilot says why in texts, PX4 in reports and texts: before the acknowledgement or after it.
  defp explain({core, _actions} = acc, job, refusal, now) do
    wait = if texts(core, job) == [], do: Timing.reason(core.rtt), else: Timing.more()
    keep(acc, %{job | phase: :refused, refusal: refusal, due: now + wait})
  end

  @doc "The vehicle said something about a job that it refused. A report may be followed by a text, which says more."
  @spec explained(Core.acc(), Job.t(), :text | :report, now :: integer()) :: Core.acc()
  def explained(acc, _job, :report, _now), do: acc
  def explained(acc, job, :text, now), do: keep(acc, %{job | due: min(job.due, now + Timing.more())})

  # The refusal of a repetition may mean that the vehicle did it, or is at it, since the first time.
  defp refused({core, _actions} = acc, job, refusal, wait, now) do
    wait = if Verdict.observable?(job), do: Timing.observe(core.rtt), else: wait
    keep(acc, %{job | phase: :observing, refusal: refusal, due: now + wait})
  end

  # --- The state of the vehicle

  @doc "The vehicle was observed: its state may show that the step is done."
  @spec observe(Core.acc(), Job.t(), now :: integer()) :: Core.acc()
  def observe({core, _actions} = acc, job, now) do
    # A vehicle that reports progress also reports the end.
    if job.phase not in [:instead, :running, :refused] and Job.confirmed?(job, core.vehicle),
      do: step_done(acc, job, :completed, nil, now),
      else: acc
  end

  @doc "The vehicle has booted. What was in flight may have been done or lost; nothing is as it was when the others were given."
  @spec rebooted(Core.acc(), now :: integer()) :: Core.acc()
  def rebooted({core, actions}, now) do
    acc = {put_in(%{core | repeater: Repeater.new()}.vehicle.busy_with, nil), actions}

    each(acc, fn _all -> true end, fn acc, job ->
      cond do
        job.phase == :refused ->
          finish(acc, job, job.refusal, now)

        Job.sent?(job) ->
          finish(acc, %{job | phase: :given_up}, Refusal.ended(:rebooted_unknown), now)

        job.done > 0 ->
          finish(acc, job, Refusal.ended(:rebooted_between), now)

        true ->
          finish(acc, job, Refusal.ended(:rebooted_waiting), now)
      end
    end)
  end

  # --- Time

  @doc "Sends what cancels a job. A command that is the same message is not to take the answer to it for its own (C8)."
  @spec send_cancel(Core.acc(), Job.t(), [struct()], now :: integer()) :: Core.acc()
  def send_cancel({core, actions}, job, messages, now) do
    key = Job.step(job).cancel_key

    lanes =
      if key == Job.key(job), do: core.lanes, else: Turns.hush(core.lanes, key, now + Timing.busy(core.rtt))

    core = put(%{core | jobs: Ending.cancelled(core.jobs, key), lanes: lanes}, job)
    {core, [{:send, messages, Job.id(job)} | actions]}
  end

  @doc "Whether something is due about a job."
  @spec due?(Job.t(), now :: integer()) :: boolean()
  def due?(%{phase: :queued} = job, now), do: now >= job.until
  def due?(job, now), do: now >= job.due

  @doc "The next step of a job."
  @spec due(Core.acc(), Job.t(), now :: integer()) :: Core.acc()
  def due(acc, %{phase: phase} = job, now) when phase in [:queued, :turn],
    do: finish(acc, job, expired(job), now)

  # The vehicle's answers from the time when the gateway stood still have yet to be read, so the wait is extended once by the same time.
  def due(acc, %{due: due, prolonged: prolonged} = job, now) when now - due > @stall and due != prolonged do
    due = now + min(now - due, @longest_stall)
    keep(acc, %{job | due: due, prolonged: due})
  end

  def due({%{rtt: rtt}, _actions} = acc, %{phase: :sent} = job, now) do
    cond do
      job.sends < Timing.sends(rtt) and Job.step(job).repeat == :safe and now < job.until ->
        transmit(acc, job, now)

      # By a link of high latency its state was awaited together with the answer.
      Verdict.observable?(job) and rtt != :high_latency ->
        keep(acc, %{job | phase: :observing, due: now + Timing.observe(rtt)})

      true ->
        evaluate(acc, job, now)
    end
  end

  def due(acc, %{phase: :instead} = job, now) do
    if now < job.until,
      do: transmit(acc, %{job | sends: 0}, now),
      else: finish(acc, job, Refusal.ended(:expired_form), now)
  end

  # PX4 looks for a cancellation from time to time, and then at the last command only that it got.
  def due({core, actions}, %{phase: :cancelling, cancels: sent} = job, now)
      when sent in 1..4 and not is_nil(hd(job.steps).cancel) do
    messages = core.protocol.cancel(Job.step(job), core.vehicle)

    send_cancel(
      {core, actions},
      %{job | cancels: sent + 1, due: now + Timing.cancel(core.rtt)},
      messages,
      now
    )
  end

  def due(acc, %{phase: :cancelling} = job, now),
    do: finish(acc, %{job | phase: :given_up}, Refusal.ended(:cancel_unanswered), now)

  def due(acc, %{phase: :refused} = job, now), do: finish(acc, job, job.refusal, now)
  def due(acc, job, now), do: evaluate(acc, job, now)

  defp evaluate({core, _actions} = acc, job, now) do
    case Verdict.of(job, core.vehicle, Timing.quiet(core.rtt)) do
      {:completed, reason} ->
        step_done(acc, job, :completed, reason, now)

      # The next summary of a vehicle behind a link of high latency may be minutes away.
      {:unknown, _reason} when core.rtt == :high_latency and job.accepted_at != nil and tl(job.steps) == [] ->
        step_done(acc, job, :accepted, Refusal.text(:shown_later), now)

      verdict ->
        finish(acc, %{job | phase: :given_up}, verdict, now)
    end
  end

  # --- Ends

  defp step_done({core, actions} = acc, job, status, reason, now) do
    case Job.next(job) do
      nil ->
        finish(acc, job, {status, reason}, now)

      next ->
        lanes = core.lanes |> leave(job, core, now) |> Turns.push_front(Job.key(next), Job.id(next))
        {put(%{core | lanes: lanes}, next), actions}
    end
  end

  @doc "The end of a job."
  @spec finish(Core.acc(), Job.t(), {Result.status(), String.t() | nil}, now :: integer()) :: Core.acc()
  def finish({core, actions}, job, {status, reason}, now) do
    reason =
      if job.done > 0 and status != :expired and reason, do: "step #{job.done + 1}: " <> reason, else: reason

    reason = if status in @explained and Job.sent?(job), do: why(core, job, reason), else: reason

    reason =
      if job.done > 0 and status not in [:completed, :accepted], do: changed(core, job, reason), else: reason

    core = %{core | jobs: Map.delete(core.jobs, Job.id(job)), lanes: leave(core.lanes, job, core, now)}
    {core, [{:result, Job.result(job, status, reason, now)} | actions]}
  end

  # The changes of the steps before it.
  defp changed(%{vehicle: %{mode: now}}, %{mode: before}, reason) when before != nil and now != before,
    do: "#{reason}; its mode is now #{now}, and was #{before}"

  defp changed(_core, _job, reason), do: reason

  # The vehicle's own texts since the step was sent.
  defp why(core, job, reason) do
    words = if (texts = texts(core, job)) == [], do: note_message(core, job, :report), else: texts
    words = Enum.reject(words, &String.contains?(reason, &1))

    checks =
      if job.command.type == "arm" and core.vehicle.arming_checks != [],
        do: "; failing checks: " <> Enum.join(core.vehicle.arming_checks, ", "),
        else: ""

    reason <> if(words == [], do: "", else: "; it said: " <> Enum.join(words, "; ")) <> checks
  end

  defp texts(core, job), do: note_message(core, job, :text)

  defp note_message(core, job, kind),
    do: for({at, ^kind, words} <- core.said, at >= job.first_sent, do: words) |> Enum.uniq() |> Enum.reverse()

  # Another of the same key waits until no answer to this one can come any more (C8).
  defp leave(lanes, job, core, now) do
    quiet =
      cond do
        not Job.sent?(job) -> now
        job.accepted_at -> now + Timing.quiet(core.rtt, job.sends)
        # The vehicle may be at it, and only have been not heard.
        job.phase == :given_up -> now + Timing.busy(core.rtt)
        true -> max(now + Timing.quiet(core.rtt), job.last_sent + Timing.answer(core.rtt))
      end

    lanes |> Turns.leave(Job.key(job), Job.id(job), quiet) |> Turns.hush(Job.step(job).ends, quiet)
  end

  # --- Jobs

  @doc "The core with a job as it is now."
  @spec put(Core.t(), Job.t()) :: Core.t()
  def put(core, job), do: %{core | jobs: Map.put(core.jobs, Job.id(job), job)}

  @doc "The same with the actions so far."
  @spec keep(Core.acc(), Job.t()) :: Core.acc()
  def keep({core, actions}, job), do: {put(core, job), actions}

  @doc "Deals with the jobs that an event is about, each as those before left it, in the order of their submission."
  @spec each(Core.acc(), (Job.t() -> boolean()), (Core.acc(), Job.t() -> Core.acc())) :: Core.acc()
  def each({core, _actions} = acc, about?, fun) do
    core.jobs
    |> Map.values()
    |> Enum.filter(about?)
    |> Enum.sort_by(&{&1.since, Job.id(&1)})
    |> Enum.reduce(acc, fn %{command: %{id: id}}, {core, _actions} = acc ->
      case core.jobs do
        %{^id => job} -> if about?.(job), do: fun.(acc, job), else: acc
        _gone -> acc
      end
    end)
  end
end
