defmodule Msp.Session.Params do
  @moduledoc """
  The parameter protocol of MAVLink for a flight controller with MSP: PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET, answered by PARAM_VALUE and
  PARAM_ERROR.

  Betaflight's parameters are fields of blocks (`Blocks`), and from API 1.48 on settings by name (`Lines`); iNav's are settings by name (`Settings`).
  Nothing is set while the vehicle is armed, and nothing is kept over a restart before the settings are stored (PREFLIGHT_STORAGE). Text
  cannot be a parameter in MAVLink.
  """
  @behaviour Msp.Session.Tasks

  alias MavCodec.Message.ParamValue
  alias MavCodec.Messages, as: M
  alias MavCodec.Msp.Params
  alias Msp.{Firmware, Session}
  alias Msp.Params.Line
  alias Msp.Session.{Output, Tasks}
  alias Msp.Session.Tasks.Armed
  alias Msp.Session.Params.{Answers, Blocks, Lines, ReadAll, Settings}
  alias Protocols.Params.Listing

  defstruct [:listing, unsaved: false]

  @typedoc "`listing`: nil until they were read; `unsaved`: some were set and not stored."
  @type t :: %__MODULE__{listing: Listing.t() | nil, unsaved: boolean}

  @messages [M.ParamRequestList.id(), M.ParamRequestRead.id(), M.ParamSet.id()]
  @notice 5
  # From here on floats leave integers out, and no setting that is a float goes so far.
  @inexact 0x1000000
  # After the first time.
  @tries 2

  @doc "The request by which a written parameter is read again."
  @callback again(Tasks.task()) :: {String.t(), map}

  @doc """
  What the reply to a request says: what has to be known to write it, the value and its type; or changes of the task, if
  there is more to be asked.
  """
  @callback read(Tasks.task(), values :: map) ::
              {:ok, known :: term, number | nil, Answers.type()} | {:more, map} | {:error, String.t()}

  @doc "The request that sets it to the task's value, and what is known of it then, nil for nothing."
  @callback write(Tasks.task(), known :: term) :: {:ok, {String.t(), map}, term} | {:error, String.t()}

  @doc "Whether this is a message of the parameter protocol."
  @spec mine?(non_neg_integer) :: boolean
  def mine?(id), do: id in @messages

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
    list? = &match?(%{what: :list}, &1)

    if Tasks.any?(session, list?),
      do: Tasks.change(session, list?, &%{&1 | tell: true}),
      else: list(session, true)
  end

  defp handle(session, %M.ParamRequestRead{param_index: -1, param_id: name}, from),
    do: read(session, name, from)

  defp handle(session, %M.ParamRequestRead{param_index: index}, from) do
    case session.params.listing && Listing.at(session.params.listing, index) do
      nil -> Answers.error(session, "", index, :unknown, from)
      name -> read(session, name, from)
    end
  end

  defp handle(session, %M.ParamSet{param_id: name, param_value: wire, param_type: type}, from) do
    case {Armed.early(session), ParamValue.asked(wire, type, :bytewise)} do
      {nil, {:ok, value}} when is_float(value) and abs(value) >= @inexact ->
        not_set(
          session,
          name,
          :mismatch,
          "a float has no room for all its digits: send the integer's bytes",
          from
        )

      {nil, {:ok, value}} ->
        begin(session, %{what: :set, name: full(session, name), value: value, from: from})

      {nil, {:error, why}} ->
        not_set(session, name, :mismatch, why, from)

      {why, _asked} ->
        not_set(session, name, :denied, why, from)
    end
  end

  defp not_set(session, name, code, why, from) do
    session
    |> Answers.error(name, nil, code, from)
    |> Output.text(@notice, "#{full(session, name)} not set: #{why}")
  end

  defp read(session, name, from), do: begin(session, %{what: :read, name: full(session, name), from: from})

  defp full(session, name), do: Params.full(session.identity.firmware, name)

  defp begin(session, %{name: name} = task) do
    repeated? = &(&1[:name] == name and &1[:what] == task.what and &1[:value] == task[:value])

    cond do
      Tasks.any?(session, repeated?) -> session
      not Tasks.room?(session) -> session
      first = first(session.identity, name) -> add(session, Map.merge(task, first))
      true -> Answers.error(session, name, nil, :unknown, task.from)
    end
  end

  defp first(%{firmware: firmware, version: version}, name) do
    settings? = Firmware.of(firmware).settings?
    param = if not settings?, do: Enum.find(Params.all(firmware, version), &(&1.name == name))

    cond do
      settings? -> Settings.first(name)
      Params.by_name?(firmware, version) and Line.name?(name) -> Lines.first(name, param)
      param -> Blocks.first(firmware, param)
      true -> nil
    end
  end

  defp add(session, task), do: Tasks.add(session, Map.merge(task, %{kind: __MODULE__, tries: 0}))

  @doc "Reads the whole list; `tell`: and reports it."
  @spec list(Session.t(), boolean) :: Session.t()
  def list(session, tell), do: add(session, ReadAll.first(session, tell))

  @impl Tasks
  # A read may be repeated. What a write without an answer did shows when it is read again.
  def answer(session, %{stage: :written} = task, :timeout, now), do: answer(session, task, {:ok, %{}}, now)

  def answer(session, %{tries: tries} = task, :timeout, _now) when tries < @tries,
    do: Tasks.ask_next(session, task, %{tries: tries + 1})

  def answer(session, %{what: :list} = task, answer, _now),
    do: ReadAll.answer(session, %{task | tries: 0}, answer)

  # Whether it was set is not known.
  def answer(session, task, :timeout, _now), do: Tasks.done(session, task)

  def answer(session, task, {:denied, why}, _now),
    do: Answers.refuse(session, task, :denied, "not set: " <> why)

  def answer(session, task, {:unfit, why}, _now), do: Answers.refuse(session, task, :denied, why)
  def answer(session, task, answer, _now), do: one(session, %{task | tries: 0}, answer)

  # One parameter is read; to set it, it is written and read again.
  defp one(session, %{stage: :written} = task, {:ok, _acknowledged}),
    do: Tasks.ask_next(session, task, %{stage: :check, ask: task.by.again(task)})

  defp one(session, %{stage: stage} = task, {:ok, values}) do
    case task.by.read(task, values) do
      {:more, changes} -> Tasks.ask_next(session, task, changes)
      {:ok, known, value, type} when stage == :check -> checked(session, task, known, value, type)
      {:ok, _known, value, type} when task.what == :read -> Answers.report(session, task, value, type)
      {:ok, known, _value, _type} -> write(session, task, known)
      {:error, why} -> Answers.refuse(session, task, :unknown, why)
    end
  end

  # A build without a command line has blocks.
  defp one(session, %{stage: :before, by: Lines, param: %{block: block} = param} = task, :refused)
       when block != nil,
       do: Tasks.ask_next(session, task, Blocks.first(session.identity.firmware, param))

  defp one(session, %{stage: stage} = task, :refused) when stage in [:before, :value],
    do: Answers.refuse(session, task, :unknown, "this firmware does not have it")

  defp one(session, task, :refused),
    do: Answers.refuse(session, task, :denied, "the flight controller refused it")

  defp write(session, task, known) do
    case task.by.write(task, known) do
      {:ok, ask, wanted} ->
        Tasks.ask_next(session, task, %{stage: :written, known: known, wanted: wanted, ask: ask})

      {:error, why} ->
        Answers.refuse(session, task, :out_of_range, why)
    end
  end

  # What is then there is reported.
  defp checked(session, %{wanted: wanted} = task, known, value, type) do
    session =
      if wanted in [nil, known],
        do: session,
        else: Output.text(session, @notice, "#{task.name}: its block is not as it was written")

    session |> Answers.changed() |> Answers.report(task, value, type)
  end

  @doc "They were stored, or the vehicle restarted without them."
  @spec stored(Session.t()) :: Session.t()
  def stored(session), do: put_in(session.params.unsaved, false)

  @doc "Another vehicle is at the line: its parameters are others."
  @spec forget(Session.t()) :: Session.t()
  def forget(session), do: put_in(session.params.listing, nil)

  @doc "The settings of a vehicle that was just found are read ahead, once: that takes iNav ten seconds."
  @spec ahead(Session.t()) :: Session.t()
  def ahead(%{params: %{listing: nil}, identity: %{firmware: firmware}} = session),
    do: if(Firmware.of(firmware).settings?, do: list(session, false), else: session)

  def ahead(session), do: session
end
