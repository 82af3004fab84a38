defmodule Msp.Session.Params.ReadAll do
  @moduledoc """
  All parameters of a vehicle, in the turns that no poll needs: Betaflight's blocks, each once, then what it has by name
  only; iNav's settings by their numbers. Those of a list that was read before are reported one by one: reading takes
  longer than clients wait, and MAVSDK aborts if it asks again and gets two lists.
  """

  alias MavCodec.Msp.Params
  alias Msp.Params.{Line, Setting}
  alias Msp.{Firmware, Session}
  alias Msp.Session.{Output, Tasks}
  alias Msp.Session.Params.{Answers, Blocks, Lines, Settings}
  alias Protocols.Params.Listing

  @most_settings 2_000

  @doc "The first request; `tell`: whether the list is reported."
  @spec first(Session.t(), boolean) :: map
  def first(session, tell) do
    if Firmware.of(session.identity.firmware).settings?,
      do: Map.merge(task(session, tell), %{ask: {"MSP2_COMMON_PG_LIST", %{}}, count: nil, at: 0}),
      else: blocks(session, tell)
  end

  defp blocks(session, tell) do
    {fields, named} = session |> rows() |> Enum.split_with(& &1.block)
    [first | blocks] = fields |> Enum.map(& &1.block) |> Enum.uniq()
    names = for row <- named, do: row.name
    Map.merge(task(session, tell), %{ask: {first, %{}}, blocks: blocks, names: names, read: []})
  end

  defp task(session, tell),
    do: %{
      by: __MODULE__,
      what: :list,
      tell: tell,
      live: tell and session.params.listing != nil,
      bulk: true,
      got: []
    }

  defp rows(%{identity: identity}), do: Params.all(identity.firmware, identity.version)

  @doc "The answer to a request of the list."
  @spec answer(Session.t(), Tasks.task(), Tasks.answer()) :: Session.t()
  def answer(session, %{blocks: blocks, ask: {block, _}} = task, answer) when blocks != nil do
    # A build without the part that a block is about refuses it.
    read = if match?({:ok, _}, answer), do: [{block, elem(answer, 1)} | task.read], else: task.read

    case blocks do
      [next | rest] -> Tasks.ask_next(session, task, %{ask: {next, %{}}, blocks: rest, read: read})
      [] -> values(session, %{task | blocks: nil, read: []}, Map.new(read))
    end
  end

  def answer(session, %{names: _names, line: nil} = task, {:ok, reply}) do
    case Lines.described(task, reply) do
      {:more, changes} -> Tasks.ask_next(session, task, changes)
      {:ok, line} -> Tasks.ask_next(session, task, %{line: line, ask: Line.get(task.name)})
      _text_or_nothing -> named(session, task)
    end
  end

  def answer(session, %{names: _names, line: line} = task, {:ok, reply}) do
    case Line.value(line, task.name, reply[:line] || "") do
      {:ok, value} -> session |> got(task, {task.name, value, Lines.told(line)}) |> named()
      :error -> named(session, task)
    end
  end

  # This build does not have it.
  def answer(session, %{names: _names} = task, _refused), do: named(session, task)

  def answer(session, %{count: nil} = task, {:ok, %{entries: [_ | _] = groups}}) do
    count = min(Enum.max(Enum.map(groups, & &1.last)) + 1, @most_settings)
    Tasks.ask_next(session, task, %{ask: Settings.info(0), count: count})
  end

  def answer(session, %{count: nil} = task, _no_list), do: complete(session, task)

  def answer(session, task, answer) do
    {session, task} =
      with {:ok, values} <- answer, {:ok, setting} <- Setting.read(values) do
        got(session, task, {setting.name, setting.value, Settings.told(setting)})
      else
        _text_or_nothing -> {session, task}
      end

    if task.at + 1 < task.count,
      do: Tasks.ask_next(session, task, %{ask: Settings.info(task.at + 1), at: task.at + 1}),
      else: complete(session, task)
  end

  defp values(session, task, blocks) do
    values =
      for param <- rows(session),
          param.block,
          number = blocks[param.block][param.field],
          do: {param.name, Blocks.value(param, number), Blocks.told(session.identity.firmware, param)}

    values
    |> Enum.reduce({session, task}, fn value, {session, task} -> got(session, task, value) end)
    |> named()
  end

  defp got(session, task, {name, value, type} = param) do
    listing = session.params.listing
    known? = task.live and is_map_key(listing.indices, name)
    told = if known?, do: [Answers.value(listing, name, value, type)], else: []
    {Output.emit(session, told), %{task | got: [param | task.got]}}
  end

  defp named({session, task}), do: named(session, task)

  defp named(session, %{names: []} = task), do: complete(session, task)

  defp named(session, %{names: [name | names]} = task) do
    Tasks.ask_next(session, task, %{names: names, name: name, text: "", line: nil, ask: Line.info(name, 0)})
  end

  defp complete(session, %{got: got, tell: tell, live: live} = task) do
    params = Enum.reverse(got)
    listing = params |> Enum.map(&elem(&1, 0)) |> Listing.new(:bytewise)
    told? = live and listing == session.params.listing
    session = put_in(session.params.listing, listing) |> Tasks.done(task)

    messages =
      for {name, value, type} <- params,
          tell and not told?,
          do: Answers.value(listing, name, value, type)

    Output.emit(session, messages)
  end
end
