defmodule Msp.Session.Params do
  @moduledoc """
  The parameter protocol of MAVLink for a flight controller with MSP: PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET, answered by PARAM_VALUE and
  PARAM_ERROR.

  Betaflight's parameters are fields of blocks. To set one, its block is read, written with that field changed, and read again; what is
  then there is reported. iNav's are read and set by name, with the same end. Nothing is set while the vehicle is armed, and nothing is
  kept over a restart before the settings are stored (PREFLIGHT_STORAGE). Text cannot be a parameter in MAVLink.
  """
  @behaviour Msp.Session.Tasks

  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.{Messages, Params, ShortName}
  alias Msp.{Modes, Session}
  alias Msp.Params.{Block, Setting}
  alias Msp.Session.{Output, Tasks}

  @request_list M.ParamRequestList.id()
  @request_read M.ParamRequestRead.id()
  @param_set M.ParamSet.id()
  # MAV_PARAM_TYPE, and what fits into it.
  @types %{
    u8: {1, 0..0xFF},
    i8: {2, -0x80..0x7F},
    u16: {3, 0..0xFFFF},
    i16: {4, -0x8000..0x7FFF},
    u32: {5, 0..0xFFFFFFFF},
    f32: {9, nil}
  }
  # MAV_PARAM_ERROR
  @unknown 1
  @out_of_range 2
  @denied 3
  @no_index 65_535
  @notice 5
  @most_settings 2_000
  # After the first time.
  @tries 2

  @doc "Whether this is a message of the parameter protocol."
  @spec mine?(non_neg_integer) :: boolean
  def mine?(id), do: id in [@request_list, @request_read, @param_set]

  @doc "A message of a client."
  @spec message(Session.t(), struct, from :: {byte, byte}, integer) :: Session.t()
  def message(
        %{system: system} = session,
        %{target_system: system, target_component: component} = message,
        from,
        _now
      )
      when component in [0, 1],
      do: handle(session, message, from)

  def message(session, _for_another, _from, _now), do: session

  defp handle(session, %M.ParamRequestList{}, _from) do
    if Enum.any?(session.tasks, &match?(%{what: :list}, &1)),
      do: %{
        session
        | tasks: Enum.map(session.tasks, &if(&1[:what] == :list, do: %{&1 | tell: true}, else: &1))
      },
      else: list(session, true)
  end

  defp handle(session, %M.ParamRequestRead{param_index: -1, param_id: name}, from),
    do: read(session, name, from)

  defp handle(session, %M.ParamRequestRead{param_index: index}, from) do
    case Enum.at(session.params || [], index) do
      nil -> error(session, "", index, @unknown, from)
      name -> read(session, name, from)
    end
  end

  defp handle(session, %M.ParamSet{param_id: name, param_value: value}, from) do
    cond do
      not is_number(value) ->
        error(session, name, @no_index, @out_of_range, from)

      Modes.armed?(session.readings[:boxes] || MapSet.new()) ->
        session
        |> error(name, @no_index, @denied, from)
        |> Output.text(@notice, "#{full(session, name)} not set: it is armed")

      true ->
        begin(session, %{what: :set, name: full(session, name), value: value, from: from})
    end
  end

  defp read(session, name, from), do: begin(session, %{what: :read, name: full(session, name), from: from})

  defp full(session, name), do: Params.full(session.identity.firmware, name)

  # A repetition of what is being done.
  defp begin(session, %{name: name} = task) do
    cond do
      Enum.any?(session.tasks, &(&1[:name] == name and &1[:what] == task.what and &1[:value] == task[:value])) ->
        session

      not Tasks.room?(session) ->
        session

      true ->
        begin(session, session.identity.firmware, task)
    end
  end

  defp begin(session, :inav, task),
    do:
      Tasks.add(session, Map.merge(task, %{kind: __MODULE__, ask: info(task.name), stage: :before, tries: 0}))

  defp begin(session, :betaflight, task) do
    case Enum.find(all(session), &(&1.name == task.name)) do
      nil ->
        error(session, task.name, @no_index, @unknown, task.from)

      param ->
        Tasks.add(
          session,
          Map.merge(task, %{kind: __MODULE__, param: param, ask: {param.block, %{}}, stage: :before, tries: 0})
        )
    end
  end

  defp all(session), do: Params.all(:betaflight, session.identity.version)
  defp info(name), do: {"MSP2_COMMON_SETTING_INFO", %{name_or_index: Setting.request(name)}}

  @doc "Reads the whole list; `tell`: and reports it."
  @spec list(Session.t(), boolean) :: Session.t()
  def list(session, tell) do
    task = %{kind: __MODULE__, what: :list, tell: tell, bulk: true, got: [], tries: 0}

    case session.identity.firmware do
      :betaflight ->
        [first | blocks] = session |> all() |> Enum.map(& &1.block) |> Enum.uniq()
        Tasks.add(session, Map.merge(task, %{ask: {first, %{}}, blocks: blocks}))

      :inav ->
        Tasks.add(session, Map.merge(task, %{ask: {"MSP2_COMMON_PG_LIST", %{}}, count: nil, at: 0}))
    end
  end

  @impl Tasks
  # A read may be repeated. What a write without an answer did shows when it is read again.
  def answer(session, %{stage: :written} = task, :timeout, now), do: answer(session, task, {:ok, %{}}, now)

  def answer(session, %{tries: tries} = task, :timeout, _now) when tries < @tries,
    do: Tasks.ask_next(session, task, %{tries: tries + 1})

  def answer(session, %{what: :list} = task, answer, _now), do: listed(session, %{task | tries: 0}, answer)

  def answer(session, task, answer, _now),
    do: one(session, session.identity.firmware, %{task | tries: 0}, answer)

  # --- the list ---

  defp listed(session, %{blocks: blocks, ask: {block, _}} = task, answer) do
    # A build without the part that a block is about refuses it.
    got = if match?({:ok, _}, answer), do: [{block, elem(answer, 1)} | task.got], else: task.got

    case blocks do
      [next | rest] ->
        Tasks.ask_next(session, task, %{ask: {next, %{}}, blocks: rest, got: got})

      [] ->
        values = Map.new(got)

        params =
          for param <- all(session),
              number = values[param.block][param.field],
              do: {param.name, value(param, number), type(param)}

        complete(session, task, params)
    end
  end

  defp listed(session, %{count: nil} = task, {:ok, %{entries: [_ | _] = groups}}) do
    count = min(Enum.max(Enum.map(groups, & &1.last)) + 1, @most_settings)
    Tasks.ask_next(session, task, %{ask: info(0), count: count})
  end

  defp listed(session, %{count: nil} = task, _no_list), do: complete(session, task, [])

  defp listed(session, task, answer) do
    got =
      with {:ok, values} <- answer, {:ok, setting} <- Setting.read(values) do
        [{setting.name, setting.value, elem(@types[setting.type], 0)} | task.got]
      else
        _text_or_nothing -> task.got
      end

    if task.at + 1 < task.count,
      do: Tasks.ask_next(session, task, %{ask: info(task.at + 1), at: task.at + 1, got: got}),
      else: complete(session, task, Enum.reverse(got))
  end

  defp complete(session, task, params) do
    session = Tasks.done(%{session | params: Enum.map(params, &elem(&1, 0))}, task)
    count = length(params)

    messages =
      for {{name, value, type}, index} <- Enum.with_index(params),
          task.tell,
          do: param_value(name, value, type, index, count)

    Output.emit(session, messages)
  end

  # --- one parameter of Betaflight ---

  defp one(session, :betaflight, %{stage: :before} = task, {:ok, values}) do
    %{param: param} = task

    case values[param.field] do
      nil -> refuse(session, task, @unknown, "this build does not have it")
      number when task.what == :read -> report(session, task, value(param, number), type(param))
      _number -> write(session, task, values)
    end
  end

  defp one(session, :betaflight, %{stage: :written} = task, {:ok, _acknowledged}),
    do: Tasks.ask_next(session, task, %{stage: :check, ask: {task.param.block, %{}}})

  defp one(session, :betaflight, %{stage: :check} = task, {:ok, values}) do
    %{param: param, wanted: wanted} = task

    session =
      if values == wanted,
        do: session,
        else: Output.text(session, @notice, "#{task.name}: its block is not as it was written")

    session |> changed() |> report(task, value(param, values[param.field] || 0), type(param))
  end

  # --- one setting of iNav ---

  defp one(session, :inav, %{stage: :before} = task, {:ok, values}) do
    case {task.what, Setting.read(values)} do
      {:read, {:ok, setting}} ->
        report(session, task, setting.value, elem(@types[setting.type], 0))

      {:set, {:ok, setting}} ->
        case Setting.write(setting, task.value) do
          {:ok, payload} ->
            Tasks.ask_next(session, task, %{
              stage: :written,
              ask: {"MSP2_COMMON_SET_SETTING", %{setting: payload}}
            })

          {:error, why} ->
            refuse(session, task, @out_of_range, why)
        end

      _text ->
        refuse(session, task, @unknown, "it is text, which MAVLink's parameters cannot be")
    end
  end

  defp one(session, :inav, %{stage: :written} = task, {:ok, _acknowledged}),
    do: Tasks.ask_next(session, task, %{stage: :check, ask: info(task.name)})

  defp one(session, :inav, %{stage: :check} = task, {:ok, values}) do
    case Setting.read(values) do
      {:ok, setting} -> session |> changed() |> report(task, setting.value, elem(@types[setting.type], 0))
      _unreadable -> Tasks.done(session, task)
    end
  end

  # --- both ---

  defp one(session, _firmware, %{stage: :before} = task, :refused),
    do: refuse(session, task, @unknown, "this firmware does not have it")

  defp one(session, _firmware, task, :refused),
    do: refuse(session, task, @denied, "the flight controller refused it")

  defp one(session, _firmware, task, {:unfit, why}), do: refuse(session, task, @denied, why)
  # Whether it was set is not known.
  defp one(session, _firmware, task, :timeout), do: Tasks.done(session, task)

  defp write(session, %{param: param} = task, values) do
    with {:ok, number} <- number(param, task.value) do
      wanted = Block.put(values, param.field, number)
      ask = {Block.write_name(param.block), Block.writing(param.block, wanted)}
      Tasks.ask_next(session, task, %{stage: :written, wanted: wanted, ask: ask})
    else
      {:error, why} -> refuse(session, task, @out_of_range, why)
    end
  end

  # As it is on the wire; Betaflight checks no range.
  defp number(%{low: low, high: high} = param, value) do
    {_type, range} = @types[field_type(param)]
    number = param.base + param.step * value

    cond do
      number != round(number) ->
        {:error, "it is a whole number"}

      low != nil and (value < low or value > high) ->
        {:error, "it goes from #{low} to #{high}"}

      param.values != [] and round(value) not in 0..(length(param.values) - 1) ->
        {:error, "it goes from 0 to #{length(param.values) - 1}"}

      round(number) not in range ->
        {:error, "it does not fit"}

      true ->
        {:ok, round(number)}
    end
  end

  defp value(%{base: 0, step: 1}, number), do: number
  defp value(param, number), do: div(number - param.base, param.step)
  defp type(param), do: elem(@types[field_type(param)], 0)

  defp field_type(param) do
    {:ok, block} = Messages.fetch(:betaflight, param.block)

    Enum.find_value(block.reply, fn field ->
      if is_map_key(field, :key) and field.key == param.field, do: field.type
    end)
  end

  defp report(session, task, value, type) do
    params = session.params || []
    index = Enum.find_index(params, &(&1 == task.name)) || @no_index
    session |> Tasks.done(task) |> Output.emit(param_value(task.name, value, type, index, length(params)))
  end

  defp param_value(name, value, type, index, count),
    do: %M.ParamValue{
      param_id: ShortName.of(name),
      param_value: value * 1.0,
      param_type: type,
      param_count: count,
      param_index: index
    }

  defp refuse(session, task, code, why) do
    session
    |> Tasks.done(task)
    |> error(task.name, @no_index, code, task.from)
    |> Output.text(@notice, "#{task.name}: #{why}")
  end

  defp error(session, name, index, code, {system, component}) do
    Output.emit(session, %M.ParamError{
      target_system: system,
      target_component: component,
      param_id: ShortName.of(name),
      param_index: if(index == @no_index, do: -1, else: index),
      error: code
    })
  end

  # Once until the next restart or the next storing.
  defp changed(%{unsaved: true} = session), do: session

  defp changed(session),
    do:
      Output.text(
        %{session | unsaved: true},
        @notice,
        "Settings changed, not stored yet: the next restart forgets them"
      )

  @doc "The settings of a vehicle that was just found are read ahead, once: that takes iNav ten seconds."
  @spec ahead(Session.t()) :: Session.t()
  def ahead(%{params: nil, identity: %{firmware: :inav}} = session), do: list(session, false)
  def ahead(session), do: session
end
