defmodule Aerie.Control.CommandExecutor.Ending do
  @moduledoc """
  Messages that end a step and look like another one, so that the vehicle's answers to both look alike: steps that end another
  (`ends` of `Aerie.Vehicle.Protocol.Step`), and what cancels a step (`cancel_key`).
  """

  alias Aerie.Vehicle.Protocol.Step
  alias Aerie.Control.CommandExecutor.{Job, Timing, Turns}

  @doc """
  The jobs while a step is sent. What it ends is waited for: the vehicle's last word about it counts, and its answers to this step do not.
  What is to end it may take the answer to it for its own.
  """
  @spec begun(jobs, Step.t(), now :: integer()) :: jobs when jobs: %{String.t() => Job.t()}
  def begun(jobs, step, now) do
    Map.new(jobs, fn {id, job} ->
      cond do
        not Job.sent?(job) -> {id, job}
        Job.step(job).ends == step.key -> {id, %{job | ambiguous?: true}}
        step.ends == nil or Job.key(job) != step.ends or job.phase in [:refused, :cancelling] -> {id, job}
        true -> {id, %{job | phase: :cancelling, ambiguous?: true, due: now + Timing.ended()}}
      end
    end)
  end

  @doc "Whether an answer to what this step ends, or to what is to end this step, may still come."
  @spec mistakable?(%{String.t() => Job.t()}, Turns.t(), Step.t(), now :: integer()) :: boolean()
  def mistakable?(jobs, lanes, step, now) do
    (step.ends != nil and Turns.answers?(lanes, step.ends, now)) or
      Enum.any?(Map.values(jobs), &(Job.sent?(&1) and Job.step(&1).ends == step.key))
  end

  @doc "The jobs while a message is sent that cancels one and is like the steps of this key; nil: like no step."
  @spec cancelled(jobs, key :: term()) :: jobs when jobs: %{String.t() => Job.t()}
  def cancelled(jobs, nil), do: jobs

  def cancelled(jobs, key) do
    Map.new(jobs, fn {id, job} ->
      {id, if(Job.sent?(job) and Job.key(job) == key, do: %{job | ambiguous?: true}, else: job)}
    end)
  end
end
