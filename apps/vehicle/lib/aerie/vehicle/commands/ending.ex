defmodule Aerie.Vehicle.Commands.Ending do
  @moduledoc """
  Steps that end another one (`ends` of `Aerie.Protocol.Step`), by the same command of MAVLink: the vehicle's answers to both look alike.
  """

  alias Aerie.Protocol.Step
  alias Aerie.Vehicle.Commands.{Job, Lanes, Timing}

  @doc "What a step ends is waited for: the vehicle's last word about it counts, and its answers to this step do not."
  @spec begun(core, Step.t(), now :: integer()) :: core when core: map()
  def begun(core, %{ends: nil}, _now), do: core

  def begun(%{jobs: jobs} = core, %{ends: key}, now) do
    ended =
      for {id, job} <- jobs,
          Job.key(job) == key,
          Job.sent?(job),
          job.phase not in [:refused, :cancelling],
          into: %{},
          do: {id, %{job | phase: :cancelling, ambiguous?: true, due: now + Timing.ended()}}

    %{core | jobs: Map.merge(jobs, ended)}
  end

  @doc "Whether an answer to what this step ends, or to what is to end this step, may still come."
  @spec mistakable?(map(), Step.t(), now :: integer()) :: boolean()
  def mistakable?(core, step, now) do
    (step.ends != nil and Lanes.answers?(core.lanes, step.ends, now)) or
      Enum.any?(Map.values(core.jobs), &(Job.sent?(&1) and Job.step(&1).ends == step.key))
  end
end
