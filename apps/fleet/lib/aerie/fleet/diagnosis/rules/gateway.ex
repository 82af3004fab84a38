defmodule Aerie.Fleet.Diagnosis.Rules.Gateway do
  @moduledoc "Rules for the gateway itself: its ids, its clock, its disk, NATS."

  @behaviour Aerie.Fleet.Diagnosis.Rules

  alias Aerie.Fleet.Bridge.Status.Readiness
  alias Aerie.Fleet.Diagnosis.Condition

  @impl true
  def names do
    [
      own_ids_taken: "an autopilot has the gateway's own ids, so the gateway ignores it",
      clock_jump: "this machine's clock was set",
      recordings_stopped: "recordings cannot be written: the disk is full or does not work",
      tracks_failing: "tracks cannot be written, so the console's replay has a gap",
      audit_failing: "the audit log cannot be written, so commands are denied",
      ledger_failing: "the ledger fails, so no command is accepted",
      files_damaged: "files of the gateway were damaged, and set aside",
      outbox_failing: "the outbox cannot be written",
      signing_not_stored: "the time stamps of signatures cannot be stored",
      nats_unreachable: "there is no connection to NATS",
      nats_not_confirming: "NATS is connected, but does not store events",
      hub_not_confirming: "the hub is connected, but does not store events",
      hub_unreachable: "a leaf node has no connection to its hub",
      signing_key_unusable: "a signing key cannot be used"
    ]
  end

  @impl true
  def check(facts) do
    List.flatten([
      identity(facts),
      clock(facts),
      recorder(facts),
      tracks(facts),
      audit(facts),
      ledger(facts),
      damaged(facts),
      outbox(facts),
      stamps(facts),
      keys(facts),
      nats(facts),
      hub(facts)
    ])
  end

  defp identity(%{identity: %{alarm: alarm}}) when is_binary(alarm) do
    new(:own_ids_taken, :error, "an autopilot has the gateway's own ids, so the gateway ignores it",
      evidence: [alarm],
      mend: "Change mavlink.component_id (191 is the on-board computer), or on a hub mavlink.system_id."
    )
  end

  defp identity(_facts), do: []

  defp clock(%{clock_steps: []}), do: []

  defp clock(%{clock_steps: [{_ago, us} | _] = steps}) do
    severity = if abs(us) >= 60_000_000, do: :warning, else: :notice

    new(:clock_jump, severity, "this machine's clock was set",
      evidence: for({ago, us} <- steps, do: "#{div(ago, 1000)} s ago by #{signed(us)} s"),
      mend:
        "Times of earlier events and recordings are wrong by this much. Run chrony or systemd-timesyncd, and start the gateway when the " <>
          "clock is right."
    )
  end

  defp signed(us), do: if(us > 0, do: "+", else: "") <> :erlang.float_to_binary(us / 1_000_000, decimals: 1)

  defp recorder(%{recorder: %{recordings: recordings, space: space, dir: dir}}) do
    paused = for %{state: :paused} = recording <- recordings, do: "#{recording.label}: #{recording.reason}"

    if paused != [] or match?(%{low: true}, space) do
      new(:recordings_stopped, :error, "recordings cannot be written",
        evidence: Enum.take(paused, 4) ++ free(space),
        mend:
          "Free space on the disk of #{dir}, set recorder.dir to another folder, or keep less (recorder.max_mb)."
      )
    else
      []
    end
  end

  defp recorder(_facts), do: []

  defp free(%{free: bytes}) when is_integer(bytes), do: ["#{div(bytes, 1_048_576)} MB are free"]
  defp free(_unknown), do: []

  defp tracks(%{tracks: %{problem: problem, dir: dir}}) when is_binary(problem) do
    new(:tracks_failing, :warning, "tracks cannot be written, so the console's replay has a gap",
      evidence: [problem],
      mend:
        "Free space on the disk of #{dir}, set tracks.dir to another folder, or switch them off (tracks.enabled: off)."
    )
  end

  defp tracks(_facts), do: []

  defp audit(%{audit: nil}), do: []

  defp audit(%{audit: reason}) do
    new(
      :audit_failing,
      :error,
      "the audit log cannot be written, so commands that must be recorded are denied",
      evidence: [reason],
      mend: "Free space on its disk, or repair the folder (policy.audit.dir)."
    )
  end

  defp ledger(%{ledger: reason}) when is_binary(reason) do
    new(:ledger_failing, :error, "the ledger fails, so no command is accepted",
      evidence: [reason],
      mend: "Free space on its disk, or repair the folder (commands.ledger.dir)."
    )
  end

  defp ledger(_facts), do: []

  defp damaged(%{damaged: [_ | _] = damaged}) do
    new(:files_damaged, :warning, "files of the gateway were damaged, and set aside",
      evidence: for(file <- Enum.take(damaged, 8), do: "#{file.kept}: #{file.words}"),
      mend: "Check the disk, and restore the files from a backup if you need what they had."
    )
  end

  defp damaged(_facts), do: []

  defp outbox(%{nats: %{outbox: %{problem: problem}}}) when is_binary(problem) do
    new(:outbox_failing, :error, "the outbox cannot be written, so events wait in memory",
      evidence: [problem],
      mend: "Free space on its disk, or repair the folder (outbox.dir)."
    )
  end

  defp outbox(_facts), do: []

  defp stamps(%{signing: %{not_stored: reason}}) when is_binary(reason) do
    new(:signing_not_stored, :error, "the time stamps of signatures cannot be stored",
      evidence: [reason],
      mend: "Free space on its disk: after a restart, old signed frames could be accepted (S6)."
    )
  end

  defp stamps(_facts), do: []

  defp keys(%{signing: %{keys: keys}}) do
    case for %{error: error, key: key} when error != nil <- keys, do: "#{key}: #{error}" do
      [] ->
        []

      errors ->
        new(:signing_key_unusable, :error, "a signing key cannot be used",
          evidence: Enum.take(errors, 4),
          mend:
            "Correct the file or the value under signing; until then no frame of these vehicles can be verified."
        )
    end
  end

  defp keys(_facts), do: []

  defp nats(%{nats_off?: true}), do: []
  defp nats(%{nats: nil}), do: []
  defp nats(%{nats: %{problem: nil}}), do: []

  defp nats(%{nats: %{connected: false} = nats}) do
    new(:nats_unreachable, :error, "there is no connection to NATS",
      evidence: [nats.problem | waiting(nats)],
      mend:
        "Check nats.url, whether the server runs, and the key or password if it refuses the login: a key's file is read again at each " <>
          "attempt. The outbox keeps events meanwhile, and sends them afterwards."
    )
  end

  defp nats(%{nats: nats}) do
    new(:nats_not_confirming, :error, "NATS does not store events",
      evidence: [nats.problem | waiting(nats)],
      mend: mend(nats) <> " The outbox keeps events meanwhile."
    )
  end

  # The embedded server is restarted by the gateway.
  defp mend(%{mode: :url, url: url, outbox: %{silent?: true}}), do: restart("nats-server at #{url}")
  defp mend(_refused), do: "Check the server's disk, its JetStream limits and the streams."

  defp restart(server) do
    <<first::utf8, rest::binary>> = Readiness.mend(server)
    String.upcase(<<first::utf8>>) <> rest <> "."
  end

  defp hub(%{nats: %{hub: %{status: :down} = hub}}) do
    new(:hub_unreachable, :notice, "there is no connection to the hub",
      evidence: [hub.problem || "it does not answer" | events_wait(hub.waiting)],
      mend:
        "Check the network and nats.leaf; a new key is taken when the gateway starts again. Events wait in the local stream, and are sent " <>
          "afterwards."
    )
  end

  defp hub(%{nats: %{hub: %{stalled: why} = hub}}) when is_binary(why) do
    new(:hub_not_confirming, :error, "the hub does not store events",
      evidence: [why | events_wait(hub.waiting)],
      mend: restart("the hub's nats-server") <> " Events wait in the local stream meanwhile."
    )
  end

  defp hub(_none_or_well), do: []

  defp waiting(%{outbox: outbox}), do: events_wait(outbox[:events])

  defp events_wait(events) when is_integer(events) and events > 0, do: ["#{events} events wait"]
  defp events_wait(_none), do: []

  defp new(name, severity, title, fields),
    do: [Condition.new(name, severity, :gateway, [title: title] ++ fields)]
end
