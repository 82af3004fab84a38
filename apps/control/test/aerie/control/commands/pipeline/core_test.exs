defmodule Aerie.Control.Commands.Pipeline.CoreTest do
  @moduledoc "Whatever the parts of the gateway answer: what a command must have passed before it is sent."
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.Result
  alias Aerie.Control.Commands.Pipeline.{Core, Request}

  @us 1_795_339_800_000_000
  @operator %{name: "ops", role: :operator, permissions: []}
  @settings %{ledger_required?: true, urgent_ms: 500, record_ms: 5_000, shared?: true}
  @params %{"gripper" => %{action: "release"}, "goto" => %{lat: 47, lon: 8, altitude: 9}}
  @ends [:answer, :refuse, :finish]
  @sends [:execute, :pass_on]

  test "the usual way asks each part once, and the ledger before and right before it is sent" do
    assert names(play(core("goto"))) ==
             [:look, :take_token, :holder, :ask, :judge, :audit, :setpoints, :holder, :claim] ++
               [:sending, :holder, :commanded, :execute, :announce, :finish]

    assert names(play(core("goto", %{shared?: false}))) ==
             [:look, :take_token, :ask, :judge, :audit, :setpoints, :sending, :commanded, :execute] ++
               [:finish]
  end

  test "a repetition has its result whatever would be decided now, and costs no token" do
    stored = Result.new("a", :completed)

    for answers <- [
          %{},
          %{look: [{nil, :allow}]},
          %{look: [{snapshot(), {:deny, :role, "no"}}]},
          %{take_token: [{:deny, :rate, "no"}]},
          %{take_token: [:late]},
          %{holder: [{:unknown, "NATS is away"}]}
        ] do
      answers = Map.merge(answers, %{known: [{:stored, stored}], admit: [{:stored, stored}]})
      done = play(core("goto"), answers)
      assert {{:answer, ^stored}, nil} = List.last(done)
      assert Enum.count(done, &(name(elem(&1, 0)) == :ask)) == 1
      taken? = Enum.any?(done, &match?({:take_token, answer} when answer in [:ok, :late], &1))
      assert :put_back_token in names(done) == taken?
    end
  end

  test "the holder is looked for until it is known, and no longer than the ledger is waited for" do
    unknown = {:unknown, "NATS is away"}
    done = play(core("goto"), %{holder: [unknown, unknown]})
    assert [:ask, :holder, :wait, :holder, :ask | _more] = Enum.drop_while(names(done), &(&1 != :ask))
    done = play(core("goto"), %{holder: List.duplicate(unknown, 500)})
    assert {{:refuse, {:deny, :holder, "NATS is away; nothing was sent"}, false}, nil} = List.last(done)
  end

  test "passed on in vain: what brings a vehicle down is given here, everything else is not" do
    answers = %{holder: [{:other, "b"}], pass_on: [Result.new("a", :unknown)]}
    assert [:pass_on, :execute, :finish] = Enum.take(names(play(core("land"), answers)), -3)
    assert [:pass_on, :finish] = Enum.take(names(play(core("goto"), answers)), -2)
  end

  test "another gateway had the command: its result, or that it is not known" do
    failed = Result.new("a", :failed, "it fell")

    for {claim, status} <- [{%{by: "b", result: failed}, :failed}, {%{by: "b", result: nil}, :unknown}] do
      done = play(core("goto"), %{claim: [{:taken, claim}]})
      assert {{:finish, %Result{status: ^status, details: %{"type" => "goto"}}}, nil} = List.last(done)
      refute Enum.any?(names(done), &(&1 in [:sending | @sends]))
    end
  end

  test "model: nothing is sent but after every check, once, and every command has one end" do
    property =
      :proper.forall(situation(), fn {type, settings, via, answers} ->
        core = core(type, settings, via)
        done = play(core, answers)
        Enum.reject(rules(), fn {_rule, holds?} -> holds?.(done, core) end) == []
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 4_000]) == true, inspect(:proper.counterexample())
  end

  defp rules do
    [
      one_end: fn done, _core ->
        Enum.count(names(done), &(&1 in @ends)) == 1 and name(elem(List.last(done), 0)) in @ends
      end,
      sent_once: fn done, core ->
        case Enum.filter(names(done), &(&1 in @sends)) do
          [:pass_on, :execute] -> core.intent.ends_flight?
          sends -> length(sends) <= 1
        end
      end,
      checked: fn done, core -> sent(done) == nil or checked?(sent(done), core) end,
      recorded: fn done, core -> sent(done) == nil or recorded?(sent(done), core) end,
      held: fn done, core -> sent(done) == nil or held?(sent(done), core) end,
      # Right before the first byte nothing is waited for but the word of who holds the vehicle.
      sending_last: fn done, _core ->
        sent(done) == nil or
          Enum.drop_while(names(sent(done)), &(&1 != :sending)) -- [:holder, :commanded] == [:sending]
      end,
      ledger_asked_once: fn done, _core ->
        unknown? = Enum.any?(done, &(match?({:holder, {:unknown, _why}}, &1) or &1 == {:holder, {:mine, 0}}))
        unknown? or Enum.count(names(done), &(&1 == :ask)) <= 1
      end,
      # What was admitted keeps its refusal.
      refusal_kept: fn done, _core ->
        case List.last(done) do
          {{:refuse, _denial, stored?}, nil} -> stored? == :judge in names(done)
          _other_end -> true
        end
      end
    ]
  end

  # What had been done when it was sent first; nil if it was not.
  defp sent(done) do
    case Enum.split_while(done, fn {action, _answer} -> action not in @sends end) do
      {_all, []} -> nil
      {before, _send} -> before
    end
  end

  defp checked?(before, core) do
    answers = for {action, answer} <- before, into: %{}, do: {name(action), answer}

    match?({%{}, :allow}, answers.look) and (core.intent.ends_flight? or answers.take_token == :ok) and
      match?({:audit, _required?}, answers.judge) and answers.audit == :allow and answers.setpoints == :ok and
      not Enum.any?(before, &match?({_action, :late}, &1))
  end

  defp recorded?(before, core) do
    unrecorded? = core.intent.ends_flight? or not core.settings.ledger_required?
    repeatable? = Request.retry(core.request) == :safe

    Enum.any?(before, fn
      {{:ask, :admit}, :new} -> true
      {{:ask, :admit}, {:error, _why}} -> unrecorded?
      _other -> false
    end) and
      Enum.any?(before, fn
        {{:sending, _retry}, :ok} -> true
        {{:sending, _retry}, {:error, _why}} -> unrecorded?
        {{:sending, _retry}, {:deny, :ledger, _why}} -> unrecorded? and repeatable?
        _other -> false
      end)
  end

  # Here, passed on to the one that holds it, or urgent.
  defp held?(before, core) do
    holders = for {:holder, holder} <- before, do: holder

    core.intent.ends_flight? or not core.settings.shared? or
      case List.last(holders) do
        {:other, _name} -> length(holders) == 1 or {:ask, :known} in Enum.map(before, &elem(&1, 0))
        {:unknown, _why} -> false
        _alone_or_mine -> true
      end
  end

  defp situation do
    result = fn status -> Result.new("a", status) end
    mine = [{3, {:mine, 1_000_000}}, {1, :alone}, {1, {:mine, 0}}]

    answers = %{
      look: one_of([{8, {snapshot(), :allow}}, {1, {nil, :allow}}, {1, {snapshot(), {:deny, :role, "no"}}}]),
      take_token: one_of([{8, :ok}, {1, {:deny, :rate, "no"}}, {1, :late}]),
      holder: one_of(mine ++ [{1, {:other, "b"}}, {1, {:unknown, "why"}}]),
      known: one_of([{4, :new}, {1, {:deny, :id, "used"}}, {1, {:error, "full"}}, {1, :in_flight}]),
      admit:
        one_of([
          {8, :new},
          {1, {:deny, :id, "used"}},
          {1, {:error, "full"}},
          {1, {:stored, result.(:failed)}}
        ]),
      judge: one_of([{8, {:audit, true}}, {1, :no_policy}, {1, {:deny, :altitude, "no"}}]),
      audit: one_of([{8, :allow}, {1, {:deny, :audit, "no"}}, {1, :late}]),
      setpoints: one_of([{8, :ok}, {1, {:deny, :setpoints, "none come"}}]),
      claim: one_of([{8, :ok}, {1, {:taken, %{by: "b", result: nil}}}, {1, {:error, "NATS is away"}}]),
      sending: one_of([{8, :ok}, {1, {:deny, :ledger, "sent"}}, {1, {:error, "full"}}]),
      execute: one_of([{2, result.(:completed)}, {1, result.(:failed)}]),
      pass_on: one_of([{1, result.(:completed)}, {1, result.(:unknown)}]),
      change_lease: one_of([{2, {:ok, nil}}, {1, {:deny, :lease, "nobody is in charge"}}])
    }

    types = :proper_types.oneof(~w(goto land gripper force_disarm take_control release_control))
    bool = :proper_types.boolean()
    settings = :proper_types.fixed_list([bool, bool])
    named = for {question, answer} <- answers, do: {question, :proper_types.vector(4, answer)}

    :proper_types.bind(
      :proper_types.tuple([
        types,
        settings,
        :proper_types.oneof(["rest", "nats"]),
        :proper_types.fixed_list(Enum.map(named, &elem(&1, 1)))
      ]),
      fn {type, [ledger?, shared?], via, lists} ->
        settings = %{ledger_required?: ledger?, shared?: shared?}
        {type, settings, via, Map.new(Enum.zip(Enum.map(named, &elem(&1, 0)), lists))}
      end,
      false
    )
  end

  defp one_of(weighted),
    do: :proper_types.frequency(for {n, value} <- weighted, do: {n, :proper_types.exactly(value)})

  defp core(type, settings \\ %{}, via \\ "rest") do
    fields = [id: "a", vehicle: "VID-001", type: type, params: @params[type] || %{}]
    {:ok, command} = Command.new(fields, @us)
    Core.new(%Request{command: command, source: @operator, via: via}, Map.merge(@settings, settings))
  end

  # Plays the gateway. `answers` has what each question is answered with, in turn, `:late` for the usual answer after
  # the deadline; without one it is the usual answer. Gives what was done, with its answers; nil for what has none.
  defp play(core, answers \\ %{}, event \\ :start, now \\ %{us: @us, ms: 0}, done \\ []) do
    {core, actions} = Core.handle(core, event, now)
    {said, [last]} = Enum.split(actions, -1)
    done = Enum.reverse(Enum.map(said, &{&1, nil})) ++ done

    if name(last) in @ends do
      Enum.reverse([{last, nil} | done])
    else
      {answer, answers} = answer(question(last), answers)
      us = now.us + if answer == :late, do: 1_000_000_000, else: 0
      ms = now.ms + if last == :holder, do: 40, else: 1
      event = event(last, if(answer == :late, do: usual(question(last)), else: answer))
      play(core, answers, event, %{us: us, ms: ms}, [{last, answer} | done])
    end
  end

  defp answer(question, answers) do
    case answers[question] do
      [next | later] -> {next, Map.put(answers, question, later)}
      _no_more -> {usual(question), answers}
    end
  end

  defp name(action) when is_tuple(action), do: elem(action, 0)
  defp name(action), do: action

  defp question({:ask, what}), do: what
  defp question(action), do: name(action)

  defp usual(:look), do: {snapshot(), :allow}
  defp usual(:holder), do: {:mine, 1_000_000}
  defp usual(question) when question in [:known, :admit], do: :new
  defp usual(:judge), do: {:audit, true}
  defp usual(:audit), do: :allow
  defp usual(question) when question in @sends, do: Result.new("a", :completed)
  defp usual(:change_lease), do: {:ok, nil}
  defp usual(_question), do: :ok

  defp event(:look, {snapshot, admission}), do: {:seen, snapshot, admission}
  defp event(:take_token, answer), do: {:token, answer}
  defp event({:wait, _ms}, _answer), do: :waited
  defp event({:ask, _what}, answer), do: {:known, answer}
  defp event(:judge, answer), do: {:judged, answer}
  defp event({:audit, _required?}, answer), do: {:judged, answer}
  defp event({:claim, _ms}, answer), do: {:claimed, answer}
  defp event({:change_lease, _change}, answer), do: {:lease, answer}
  defp event(send, answer) when send in @sends, do: {:result, answer}
  defp event(action, answer), do: {name(action), answer}

  defp snapshot, do: %Aerie.Vehicle.Snapshot{id: "VID-001", key: {"main", 1}, status: :online}

  defp names(done), do: Enum.map(done, fn {action, _answer} -> name(action) end)
end
