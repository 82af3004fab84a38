defmodule Aerie.Fleet.Shadow.DocumentsTest do
  @moduledoc "Desired documents in a real nats-server, on disk, and among gateways; the test is the loop."
  use Aerie.ShadowCase, async: true

  alias Aerie.Base.{Names, Store}
  alias Aerie.Fleet.Nats
  alias Aerie.Fleet.Shadow.Document
  alias Aerie.Fleet.Shadow.Store.Buckets
  alias Aerie.Fleet.Shadow.Store.LeaseSeal

  @moduletag :tmp_dir
  @moduletag :capture_log

  @vehicle "VID-007"
  @admin %{name: "ops", role: :admin, permissions: []}

  defp update(gateway, desired, more \\ %{}),
    do: Shadow.update(gateway, @vehicle, Map.put(more, "desired", desired), @admin, "rest")

  # With an embedded server of its own, and the test joined as the loop.
  defp with_nats(dir, overrides \\ []) do
    gateway = start_bridge(config(dir))
    url = await_up(gateway)
    start_shadow(gateway, dir, [{"nats.mode", "embedded"}, {"shadow.lease_s", 1} | overrides])
    join(gateway)
    eventually(fn -> Documents.authority(gateway, @vehicle) == :mine end)
    %{gateway: gateway, url: url, conn: client(url)}
  end

  defp join(gateway) do
    Documents.join(documents(gateway), @vehicle)
    Documents.vehicle_heard(documents(gateway), @vehicle, true)
    assert_receive {:desired, _document}
  end

  describe "without NATS (nats.mode: off)" do
    test "the folder is all there is: documents outlive the process, and damaged copies are not used", %{
      tmp_dir: dir
    } do
      gateway = make_ref()
      start_supervised!({Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})})
      start_shadow(gateway, dir)
      join(gateway)

      assert {:ok, %{"version" => 1, "desired" => %{"mode" => "LOITER"}}} =
               update(gateway, %{"mode" => "LOITER"})

      assert_receive {:desired, %Document{version: 1}}
      assert Documents.authority(gateway, @vehicle) == :mine
      assert {:error, {:conflict, _why}} = update(gateway, %{"mode" => "RTL"}, %{"version" => 0})

      stop_supervised!({:shadow, gateway})
      start_shadow(gateway, dir)
      Documents.join(documents(gateway), @vehicle)
      assert_receive {:desired, %Document{version: 1, fields: %{"mode" => %{actor: "ops"}}}}
      assert {:ok, %{"version" => 2}} = Shadow.delete(gateway, @vehicle, %{}, @admin, "rest")

      stop_supervised!({:shadow, gateway})
      copy = Path.join(dir, "shadow/desired/#{@vehicle}.json")
      assert {:ok, %{mode: mode}} = File.stat(copy)
      assert Bitwise.band(mode, 0o777) == 0o600
      File.write!(copy, String.replace(File.read!(copy), "ops", "eve"))
      start_shadow(gateway, dir)
      Documents.join(documents(gateway), @vehicle)
      assert_receive {:desired, %Document{version: 0}}
      assert Documents.problem(gateway) =~ "its seal does not fit"
    end

    test "an update is refused without the permission, and when too many come", %{tmp_dir: dir} do
      gateway = make_ref()
      start_supervised!({Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})})
      start_shadow(gateway, dir)
      operator = %{name: "op", role: :operator, permissions: []}
      viewer = %{name: "wall", role: :viewer, permissions: [:fly]}
      change = &Shadow.update(gateway, @vehicle, %{"desired" => &2}, &1)

      assert {:error, {:role, "params.A needs the permission maintain, which op does not have"}} =
               change.(operator, %{"mode" => "RTL", "params" => %{"A" => 1}})

      off = %{"geofence" => %{"enabled" => false}}

      assert {:error, {:role, "geofence.enabled needs the permission protection" <> _}} =
               change.(operator, off)

      maintainer = %{operator | permissions: [:maintain]}
      fence = %{"params" => %{"FENCE_ENABLE" => 0}}

      assert {:error, {:role, "params.FENCE_ENABLE needs the permission protection" <> _}} =
               change.(maintainer, fence)

      assert {:ok, _done} = change.(@admin, Map.merge(off, fence))
      assert {:error, {:role, "mode needs" <> _}} = change.(viewer, %{"mode" => "RTL"})
      assert {:error, {:role, "mode needs" <> _}} = change.(viewer, %{"mode" => nil})
      assert {:error, {:role, _why}} = Shadow.delete(gateway, @vehicle, %{}, viewer)
      assert {:ok, _done} = change.(operator, %{"mode" => "RTL"})
      assert {:error, {:malformed, _errors}} = Shadow.get(gateway, "../../etc")

      assert {:error, {:malformed, _errors}} =
               Shadow.update(gateway, "a.b", %{"desired" => %{"mode" => "RTL"}})

      # Tokens are taken faster than updates are made on a busy machine.
      eventually(fn ->
        for _n <- 1..100, do: Documents.rate(gateway, "op")
        match?({:error, {:rate, "op changes" <> _}}, change.(operator, %{"tags" => ["y"]}))
      end)

      assert {:ok, _other} = change.(@admin, %{"tags" => ["x"]})
      assert Store.counter(gateway, {:shadow, :updates_refused}) >= 6
      # A limit that cannot be asked for does not give way.
      assert {:error, {:unavailable, "the shadow does not answer" <> _}} = Documents.rate(make_ref(), "op")
    end

    test "reports a folder that cannot be written, and goes on from memory", %{tmp_dir: dir} do
      gateway = make_ref()
      start_supervised!({Store, [gateway: gateway] ++ Aerie.GatewayCase.plugs(%{})})
      File.write!(Path.join(dir, "shadow"), "a file")
      start_shadow(gateway, dir)
      join(gateway)
      assert {:ok, _done} = update(gateway, %{"mode" => "RTL"})
      assert Documents.problem(gateway) =~ "shadow"
      assert Documents.document(gateway, @vehicle).version == 1
    end
  end

  describe "in NATS" do
    test "documents are in the bucket, races are won one after the other, and what is reported is there", %{
      tmp_dir: dir
    } do
      %{gateway: gateway, conn: conn} = with_nats(dir)

      1..12
      |> Enum.map(&Task.async(fn -> update(gateway, %{"params" => %{"P#{&1}" => &1}}) end))
      |> Task.await_many(Aerie.Patience.ms())

      assert {:ok, %{"version" => 12, "desired" => %{"params" => params}}} = Shadow.get(gateway, @vehicle)
      assert map_size(params) == 12

      assert %{"version" => 12, "seal" => _seal} =
               conn |> KV.get_value("fleet_desired", "test.#{@vehicle}") |> JSON.decode!()

      eventually(fn -> Documents.document(gateway, @vehicle).version == 12 end)

      Documents.report(documents(gateway), @vehicle, %{"mode" => %{state: :pending}}, %{"mode" => "GUIDED"})
      eventually(fn -> KV.get_value(conn, "fleet_reported", "test.#{@vehicle}") == ~s({"mode":"GUIDED"}) end)
      assert [%{"mode" => %{state: :pending}}] = Documents.reports(gateway)
    end

    test "a lost race is tried again on the new value, and others who never stop end it", %{tmp_dir: dir} do
      %{gateway: gateway} = with_nats(dir)
      assert {:ok, %{"version" => 1}} = update(gateway, %{"params" => %{"A" => 1}})
      test = self()

      # Between its reading and its writing another one writes, up to version `n`.
      change = fn n ->
        Documents.change(gateway, @vehicle, fn document ->
          send(test, {:tried_on, document.version})

          if document.version < n,
            do: assert({:ok, _} = update(gateway, %{"params" => %{"B" => document.version}}))

          {:ok, %{document | version: document.version + 1}}
        end)
      end

      assert {:ok, %{version: 3, fields: %{"params.A" => _, "params.B" => _}}} = change.(2)
      for version <- [1, 2], do: assert_received({:tried_on, ^version})
      refute_received {:tried_on, _version}
      assert {:error, {:unavailable, "others change the document all the time" <> _}} = change.(1_000)
      # What is shown here may follow a little later.
      eventually(fn -> Documents.document(gateway, @vehicle).version == 23 end)
    end

    test "what was stored is stored, although its answer came too late", %{tmp_dir: dir} do
      %{gateway: gateway, conn: conn} = with_nats(dir)
      kept = Aerie.Base.Names.value(gateway, :shadow_documents)
      update = %Shadow.Update{changes: %{"mode" => "LOITER"}}
      author = %{actor: "ops", via: "rest"}

      change = fn conn, vehicle ->
        now = System.os_time(:microsecond)
        set = &Document.apply(&1, update, author, now)
        Buckets.change(conn, kept, Document.new(vehicle), set, fn -> :ok end)
      end

      # Each waits for an answer that does not come.
      lost = Task.async(fn -> change.(without_writes(conn), "VID-001") end)

      overtaken =
        Task.async(fn ->
          unanswered = without_answers(conn, fn -> {:ok, %{version: 2}} = change.(conn, "VID-002") end)
          change.(unanswered, "VID-002")
        end)

      assert {:ok, %{version: 1}} = change.(without_answers(conn, fn -> :ok end), "VID-003")
      assert {:ok, %{version: 1}, _revision} = Buckets.read(conn, kept, "VID-003")
      assert {:ok, %{version: 1}} = Task.await(overtaken, Aerie.Patience.ms())
      assert {:ok, %{version: 2}, _revision} = Buckets.read(conn, kept, "VID-002")

      assert {:error, {:unavailable, "NATS did not store it" <> _}} =
               Task.await(lost, Aerie.Patience.ms())

      assert {:none, 0} = Buckets.read(conn, kept, "VID-001")
    end

    # A connection on which what is written is stored, and the answer is lost; `fun` is called as soon as it is stored.
    defp without_answers(conn, fun) do
      between(conn, fn {:request, _alias, message} ->
        alias = Process.alias()
        reply = GenServer.call(conn, {:request, alias, message})
        assert_receive {^alias, %{body: stored}}
        assert IO.iodata_to_binary(stored) =~ "seq"
        fun.()
        reply
      end)
    end

    # One on which it is lost itself.
    defp without_writes(conn), do: between(conn, fn _request -> {:ok, "_INBOX.none"} end)

    defp between(conn, write) do
      spawn_link(fn -> forward(conn, write) end)
    end

    defp forward(conn, write) do
      receive do
        {:"$gen_call", from, {:request, _alias, {"$KV." <> _key, _body, _headers}} = request} ->
          GenServer.reply(from, write.(request))

        {:"$gen_call", from, request} ->
          GenServer.reply(from, GenServer.call(conn, request))

        {:"$gen_cast", message} ->
          GenServer.cast(conn, message)
      end

      forward(conn, write)
    end

    test "what no gateway wrote is not heeded, and the next update puts it right", %{tmp_dir: dir} do
      %{gateway: gateway, conn: conn} = with_nats(dir)
      {:ok, _one} = update(gateway, %{"mode" => "LOITER"})
      assert_receive {:desired, %{version: 1}}
      key = "test.#{@vehicle}"
      genuine = KV.get_value(conn, "fleet_desired", key)

      refused = fn -> Store.counter(gateway, {:shadow, :documents_refused}) end

      # One after the other: who connects again reads only the last one, and counts it again.
      for forged <- [
            "junk",
            String.replace(genuine, "LOITER", "ACRO"),
            String.replace(genuine, ~s("version":1), ~s("version":9))
          ] do
        before = refused.()
        :ok = KV.put_value(conn, "fleet_desired", key, forged)
        eventually(fn -> refused.() > before end)
      end

      eventually(fn -> (Documents.problem(gateway) || "") =~ "is not heeded" end)
      refute_received {:desired, _forged}

      assert {:ok, %{"version" => 2, "desired" => %{"mode" => "LOITER", "tags" => ["a"]}}} =
               update(gateway, %{"tags" => ["a"]})

      # Z5: an older one, sealed as it is, is none.
      eventually(fn -> Documents.document(gateway, @vehicle).version == 2 end)
      before = refused.()
      :ok = KV.put_value(conn, "fleet_desired", key, genuine)
      eventually(fn -> refused.() > before end)
      assert Documents.document(gateway, @vehicle).version == 2
      assert {:ok, %{"version" => 3}} = update(gateway, %{"tags" => ["b"]})
    end

    test "a key or a bucket that somebody deletes comes back", %{tmp_dir: dir} do
      %{gateway: gateway, conn: conn} = with_nats(dir)
      {:ok, _one} = update(gateway, %{"mode" => "LOITER"})
      assert_receive {:desired, %{version: 1}}

      there? = fn ->
        match?(%{"version" => 1}, decoded(KV.get_value(conn, "fleet_desired", "test.#{@vehicle}")))
      end

      :ok = KV.delete_key(conn, "fleet_desired", "test.#{@vehicle}")
      eventually(there?)
      for bucket <- ~w(fleet_desired fleet_leases fleet_reported), do: :ok = KV.delete_bucket(conn, bucket)
      eventually(there?)
      eventually(fn -> Documents.authority(gateway, @vehicle) == :mine end)
      eventually(fn -> match?({:ok, %{"version" => _next}}, update(gateway, %{"tags" => ["x"]})) end)
    end

    test "while the server is away nothing is changed or done; afterwards everything goes on", %{tmp_dir: dir} do
      %{gateway: gateway, conn: conn} = with_nats(dir)
      {:ok, _one} = update(gateway, %{"mode" => "LOITER"})
      assert_receive {:desired, %{version: 1}}
      Process.unlink(conn)
      old = Bridge.connection(gateway)
      # A server that cannot come back for now.
      pid = server_pid(dir)
      {_text, 0} = System.cmd("kill", ["-STOP", pid])
      eventually(fn -> match?({:held, _by, _why}, Documents.authority(gateway, @vehicle)) end)
      {_text, 0} = System.cmd("kill", ["-CONT", pid])
      kill9(pid)
      await_reconnected(gateway, old)
      eventually(fn -> Documents.authority(gateway, @vehicle) == :mine end)

      assert {:ok, %{"version" => 2}} =
               eventually(fn -> with {:error, _why} <- update(gateway, %{"tags" => ["x"]}), do: false end)
    end

    test "what an earlier version sealed with the common key is read, and sealed again with the vehicle's", %{
      tmp_dir: dir
    } do
      %{gateway: gateway, conn: conn} =
        with_nats(dir, [{"shadow.key", "new"}, {"shadow.former_key", "old"}])

      key = fn text -> %Shadow.Keys{common: Aerie.Base.Secret.new(text)} end

      now = System.os_time(:microsecond)
      {:ok, update} = Shadow.Update.parse(%{"desired" => %{"mode" => "LOITER"}}, now)
      {:ok, document} = Document.apply(Document.new(@vehicle), update, %{actor: "ops", via: "rest"}, now)

      for id <- [@vehicle, "VID-008"] do
        text = sealed_before(%{document | vehicle: id}, "test", key.("old"))
        :ok = KV.put_value(conn, "fleet_desired", "test.#{id}", text)

        eventually(fn ->
          {:ok, %{data: text}} =
            Gnat.Jetstream.API.Stream.get_message(conn, "KV_fleet_desired", %{
              last_by_subj: "$KV.fleet_desired.test.#{id}"
            })

          # With this vehicle's key, and nothing else.
          own = Shadow.Keys.derive("new", "test", id)

          aboard = %Shadow.Keys{
            common: Aerie.Base.Secret.new("none"),
            own: %{id => Aerie.Base.Secret.new(own)}
          }

          match?({:ok, %{version: 1}}, Shadow.Document.Sealed.decode(text, "test", id, aboard))
        end)
      end

      eventually(fn -> Documents.document(gateway, @vehicle).version == 1 end)
    end

    test "alone on its own server a gateway keeps the lease without writing, until another one writes", %{
      tmp_dir: dir
    } do
      %{gateway: gateway, conn: conn} = with_nats(dir, [{"shadow.lease_s", 4}])
      sign = "test.gateways.#{Documents.instance(gateway)}"
      revision = fn key -> conn |> Nats.KV.get("fleet_leases", key) |> elem(2) end

      until = fn ->
        %{table: table} = Names.value(gateway, :shadow_documents)
        table |> :ets.lookup_element({:authority, @vehicle}, 2) |> elem(1)
      end

      eventually(fn -> revision.(sign) > revision.("test.vehicles.#{@vehicle}") end)
      {signed, held} = {revision.(sign), until.()}
      eventually(fn -> until.() > held + 2_000 end)
      assert revision.(sign) == signed

      :ok = Nats.KV.put(conn, "fleet_leases", "test.gateways.other", "{}")
      eventually(fn -> revision.(sign) > signed end)
      assert Documents.authority(gateway, @vehicle) == :mine
    end

    test "a killed documents comes back with the document and the lease", %{tmp_dir: dir} do
      %{gateway: gateway} = with_nats(dir)
      {:ok, _one} = update(gateway, %{"mode" => "LOITER"})
      assert_receive {:desired, %{version: 1}}
      Process.exit(documents(gateway), :kill)
      eventually(fn -> documents(gateway) != nil end)
      join(gateway)
      eventually(fn -> Documents.document(gateway, @vehicle).version == 1 end)
      eventually(fn -> Documents.authority(gateway, @vehicle) == :mine end)
    end
  end

  describe "the buckets" do
    @limits [
      {"shadow.buckets.desired_max_mb", 3},
      {"shadow.buckets.desired_history", 2},
      {"shadow.buckets.reported_max_mb", 2},
      {"shadow.buckets.reported_max_age_days", 0.5},
      {"shadow.buckets.plans_max_mb", 4},
      {"shadow.buckets.plans_max_age_days", 7}
    ]

    defp limits(conn) do
      for bucket <- ~w(desired reported leases plans), into: %{} do
        {:ok, %{config: config}} = KV.info(conn, "fleet_" <> bucket)
        {bucket, {div(config.max_bytes, 1_048_576), config.max_msgs_per_subject, config.max_age}}
      end
    end

    @hour 3_600_000_000_000

    test "have the configured sizes, ages and history; those of the embedded server follow a change", %{
      tmp_dir: dir
    } do
      %{gateway: gateway, conn: conn} = with_nats(dir)

      assert %{
               "desired" => {64, 5, 0},
               "reported" => {32, 1, 0},
               "leases" => {4, 1, 0},
               "plans" => {32, 1, 0}
             } = limits(conn)

      for n <- 1..4, do: {:ok, %{"version" => ^n}} = update(gateway, %{"tags" => ["t#{n}"]})
      stop_supervised!({:shadow, gateway})
      start_shadow(gateway, dir, [{"nats.mode", "embedded"}, {"shadow.lease_s", 1} | @limits])

      eventually(fn ->
        limits(conn) == %{
          "desired" => {3, 2, 0},
          "reported" => {2, 1, 12 * @hour},
          "leases" => {4, 1, 0},
          "plans" => {4, 1, 7 * 24 * @hour}
        }
      end)

      # What was there is there, and of older ones as many as are kept.
      assert %{"version" => 4} = decoded(KV.get_value(conn, "fleet_desired", "test.#{@vehicle}"))
      assert {:ok, %{state: %{messages: 2}}} = KV.info(conn, "fleet_desired")
    end

    test "of another server are left as they are, and the difference is reported", %{tmp_dir: dir} do
      embedded = start_bridge(config(dir))
      url = await_up(embedded)
      conn = client(url)
      {:ok, _} = KV.create_bucket(conn, "fleet_desired", max_msgs_per_subject: 9, max_bytes: 1_048_576)
      nats = [{"nats.mode", "url"}, {"nats.url", [bare(url)]}, {"nats.token", URI.parse(url).userinfo}]
      gateway = start_bridge(config(Path.join(dir, "other"), nats))
      await_up(gateway)

      log =
        ExUnit.CaptureLog.capture_log(fn ->
          start_shadow(gateway, dir, nats ++ @limits)
          join(gateway)
          eventually(fn -> Documents.authority(gateway, @vehicle) == :mine end)
        end)

      assert log =~ "the bucket fleet_desired: max_bytes is 1048576, configured 3145728"
      assert log =~ "the bucket fleet_desired: max_msgs_per_subject is 9, configured 2"
      assert %{"desired" => {1, 9, 0}, "plans" => {4, 1, _week}} = limits(conn)
      assert {:ok, _done} = update(gateway, %{"mode" => "RTL"})
    end

    test "of a wrong size are refused with the key", %{tmp_dir: dir} do
      for {key, value} <- [
            {"desired_history", 65},
            {"desired_history", 0},
            {"plans_max_mb", 0},
            {"reported_max_age_days", -1}
          ] do
        assert_raise MatchError, ~r/#{key}/, fn ->
          shadow_settings(dir, [{"shadow.buckets.#{key}", value}])
        end
      end
    end
  end

  describe "two gateways that hear the same vehicle" do
    # Whoever cannot renew it for so long loses it: a second is too short on a busy machine.
    @shared [{"shadow.lease_s", 5}, {"shadow.key", "shared by both"}]

    setup %{tmp_dir: dir} do
      one = with_nats(dir, @shared)
      uri = URI.parse(one.url)
      other_dir = Path.join(dir, "other")
      url = [{"nats.mode", "url"}, {"nats.url", [bare(one.url)]}, {"nats.token", uri.userinfo}]
      gateway = start_bridge(config(other_dir, url))
      await_up(gateway)
      start_shadow(gateway, other_dir, url ++ @shared)
      Map.put(one, :other, gateway)
    end

    test "one acts, and the other one takes over when it is gone", %{
      gateway: gateway,
      other: other,
      conn: conn
    } do
      join(other)

      eventually(fn ->
        match?({:held, "gateway", "the gateway gateway-" <> _}, Documents.authority(other, @vehicle))
      end)

      # A renewal may be late.
      eventually(fn -> Documents.authority(gateway, @vehicle) == :mine end)

      # Each sees what was desired by the other.
      {:ok, _one} = update(other, %{"mode" => "LOITER"})
      eventually(fn -> Documents.document(gateway, @vehicle).version == 1 end)

      # Only who acts reports.
      Documents.report(documents(gateway), @vehicle, %{}, %{"by" => "one"})
      eventually(fn -> KV.get_value(conn, "fleet_reported", "test.#{@vehicle}") == ~s({"by":"one"}) end)
      Documents.report(documents(other), @vehicle, %{}, %{"by" => "other"})
      assert {:ok, %{"reported" => %{"by" => "one"}}} = Shadow.get(other, @vehicle)

      # Without a word, as by a kill -9: its lease is not given back.
      :sys.suspend(documents(gateway), Aerie.Patience.ms())
      eventually(fn -> Documents.authority(other, @vehicle) == :mine end)

      assert {:held, "nats", "the lease could not be renewed in time"} =
               Documents.authority(gateway, @vehicle)

      :sys.resume(documents(gateway), Aerie.Patience.ms())
      eventually(fn -> match?({:held, "gateway", _why}, Documents.authority(gateway, @vehicle)) end)
      eventually(fn -> Documents.authority(other, @vehicle) == :mine end)
    end

    test "kill -9 of the VM of the one that acts: the other one has what was desired, and takes over",
         context do
      %{gateway: gateway, tmp_dir: dir} = context
      # The one of this VM leaves it to the other VM.
      Documents.vehicle_heard(documents(gateway), @vehicle, false)
      uri = URI.parse(context.url)

      script = """
      Application.ensure_all_started(:fleet)
      alias Aerie.Base.PubSub
      dir = #{inspect(Path.join(dir, "third"))}
      url = [{"nats.mode", "url"}, {"nats.url", [#{inspect(bare(context.url))}]}, {"nats.token", #{inspect(uri.userinfo)}}]
      {:ok, _} = Aerie.Base.Store.start_link([gateway: :g] ++ Aerie.GatewayCase.plugs(%{}))
      {:ok, _} = PubSub.start_link(gateway: :g)
      {:ok, _} = Aerie.Fleet.Bridge.Supervisor.start_link(gateway: :g, settings: Aerie.BridgeCase.config(dir, url))
      settings = Aerie.ShadowCase.shadow_settings(dir, url ++ #{inspect(@shared)})
      {:ok, _} = Aerie.Fleet.Shadow.Supervisor.start_link(gateway: :g, settings: settings)
      Aerie.Fleet.Shadow.Documents.join(Aerie.ShadowCase.documents(:g), "VID-007")
      Aerie.Fleet.Shadow.Documents.vehicle_heard(Aerie.ShadowCase.documents(:g), "VID-007", true)
      wait = fn wait -> if Aerie.Fleet.Shadow.Documents.authority(:g, "VID-007") == :mine, do: :ok, else: (Process.sleep(20); wait.(wait)) end
      wait.(wait)
      {:ok, _} = Aerie.Fleet.Shadow.update(:g, "VID-007", %{"desired" => %{"mode" => "LOITER"}})
      IO.puts("acts \#{System.pid()}")
      Process.sleep(:infinity)
      """

      {_port, pid} = other_vm(script, "acts ")
      Documents.vehicle_heard(documents(gateway), @vehicle, true)

      eventually(fn ->
        match?({:held, "gateway", "the gateway" <> _}, Documents.authority(gateway, @vehicle))
      end)

      kill9(pid)
      eventually(fn -> Documents.authority(gateway, @vehicle) == :mine end)
      assert %{version: 1, fields: %{"mode" => %{value: "LOITER"}}} = Documents.document(gateway, @vehicle)
    end

    # S3: what proves who holds a vehicle is a seal, not access to NATS.
    test "a forged lease, one of another key and an old one that is sent again take the vehicle from nobody",
         context do
      %{gateway: gateway, other: other, conn: conn} = context
      join(other)
      key = "test.vehicles.#{@vehicle}"
      mine? = fn -> Documents.authority(gateway, @vehicle) == :mine end

      theirs? = fn ->
        match?({:held, "gateway", "the gateway gateway-" <> _}, Documents.authority(other, @vehicle))
      end

      refused = fn gateway -> Store.counter(gateway, {:shadow, :leases_refused}) end
      eventually(fn -> mine?.() and theirs?.() end)
      {:ok, owner, seal, _revision} = Nats.KV.get_with(conn, "fleet_leases", key, "Aerie-Seal")
      named = [{"Aerie-Seal", seal}]

      stranger = %Shadow.Keys{common: Aerie.Base.Secret.new("the key of somebody else")}
      now = System.os_time(:millisecond) + 1_000
      forged = LeaseSeal.headers(stranger, "test", {:vehicle, @vehicle}, "ee00", now)

      for {value, headers} <- [{"ee00", []}, {"ee00", forged}, {"ee00", named}] do
        before = for g <- [gateway, other], do: {g, refused.(g)}
        sign = JSON.encode!(%{"gateway" => "evil"})
        :ok = Nats.KV.put(conn, "fleet_leases", "test.gateways.ee00", sign, headers: headers)
        :ok = Nats.KV.put(conn, "fleet_leases", key, value, headers: headers)
        for {g, n} <- before, do: eventually(fn -> refused.(g) >= n + 2 end)
        assert mine?.() and theirs?.()
        assert Documents.holder(gateway, @vehicle) == :alone
      end

      # The one that holds it writes it again, with a later number: the first word, sent again, is then an old one.
      eventually(fn ->
        match?(
          {:ok, ^owner, later, _} when later not in [nil, seal],
          Nats.KV.get_with(conn, "fleet_leases", key, "Aerie-Seal")
        )
      end)

      before = refused.(other)
      :ok = Nats.KV.put(conn, "fleet_leases", key, owner, headers: named)
      eventually(fn -> refused.(other) > before end)

      # Nor does a removal that no gateway sealed.
      before = refused.(other)
      :ok = Nats.KV.delete(conn, "fleet_leases", key)
      eventually(fn -> refused.(other) > before end)
      assert mine?.() and theirs?.()
    end

    test "nobody is known to hold a vehicle before its loop says whether it is heard", context do
      documents = documents(context.gateway)
      Documents.join(documents, "VID-008")
      # Leases are renewed, and authorities recorded, at any time.
      send(documents, :renew)
      _done = :sys.get_state(documents, Aerie.Patience.ms())
      assert {:unknown, _why} = Documents.holder(context.gateway, "VID-008")
      assert {:held, "gateway", _why} = Documents.authority(context.gateway, "VID-008")

      Documents.vehicle_heard(documents, "VID-008", true)
      eventually(fn -> Documents.holder(context.gateway, "VID-008") == :alone end)
    end

    test "an orderly end, and not hearing the vehicle any more, give it to the other one at once", context do
      %{gateway: gateway, other: other} = context
      join(other)

      eventually(fn ->
        match?({:held, "gateway", "the gateway" <> _}, Documents.authority(other, @vehicle))
      end)

      Documents.vehicle_heard(documents(gateway), @vehicle, false)
      eventually(fn -> Documents.authority(other, @vehicle) == :mine end)
      Documents.vehicle_heard(documents(gateway), @vehicle, true)
      stop_supervised!({:shadow, other})
      eventually(fn -> Documents.authority(gateway, @vehicle) == :mine end)
    end
  end

  test "keys of buckets are those of this environment only" do
    assert Buckets.vehicle("test.VID-007", "test") == "VID-007"
    assert Buckets.vehicle("prod.VID-007", "test") == nil
    assert Buckets.lease("test.gateways.a", "test") == {:gateway, "a"}
    assert Buckets.lease("test.vehicles.V", "test") == {:vehicle, "V"}
    assert Buckets.lease("test.V", "test") == nil
  end

  defp decoded(text) when is_binary(text), do: JSON.decode!(text)
  defp decoded(_none), do: nil
end
