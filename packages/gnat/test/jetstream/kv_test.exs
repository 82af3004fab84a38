defmodule Gnat.Jetstream.KVTest do
  use ExUnit.Case, async: true

  import Gnat.Test

  alias Gnat.Error
  alias Gnat.Jetstream.API
  alias Gnat.Jetstream.API.{Consumer, KV}
  alias Gnat.Test.NatsServer

  @moduletag :capture_log

  setup_all do
    {:ok, server: start_supervised!({NatsServer, jetstream: true})}
  end

  setup %{server: server} do
    {:ok, gnat} = Gnat.start_link(NatsServer.settings(server, %{no_responders: true}))
    bucket = unique("bucket")
    {:ok, _} = KV.create_bucket(gnat, bucket, history: 3, storage: :memory)
    {:ok, gnat: gnat, bucket: bucket}
  end

  describe "buckets" do
    test "are streams with the options", %{gnat: gnat} do
      bucket = unique("options")

      opts = [
        ttl: 60_000_000_000,
        history: 5,
        description: "d",
        max_value_size: 100,
        limit_marker_ttl: 1_000_000_000
      ]

      assert {:ok, %{config: config}} = KV.create_bucket(gnat, bucket, opts)

      assert %API.Stream{max_msgs_per_subject: 5, max_age: 60_000_000_000, duplicate_window: 60_000_000_000} =
               config

      assert %API.Stream{description: "d", max_msg_size: 100, storage: :file, allow_rollup_hdrs: true} =
               config

      assert {:ok, %{config: ^config}} = KV.create_bucket(gnat, bucket, opts)
      assert {:ok, %{config: ^config}} = KV.info(gnat, bucket)
      assert {:error, %{"code" => _}} = KV.put_value(gnat, bucket, "a", :binary.copy("x", 101))
    end

    # Leaf nodes and other accounts read a bucket so: the subject says which key, and permissions can name it.
    test "answer direct requests with the last value of a key, its revision and what was done to it", %{
      gnat: gnat,
      bucket: bucket
    } do
      get = fn key -> Gnat.request(gnat, "$JS.API.DIRECT.GET.KV_#{bucket}.$KV.#{bucket}.#{key}", "") end
      assert {:ok, %{config: %{allow_direct: true}}} = KV.info(gnat, bucket)
      for value <- ["one", "two"], do: :ok = KV.put_value(gnat, bucket, "a.b", value)
      assert {:ok, %{body: "two", headers: headers}} = get.("a.b")
      assert {"nats-sequence", "2"} in headers
      :ok = KV.delete_key(gnat, bucket, "a.b")
      assert {:ok, %{body: "", headers: headers}} = get.("a.b")
      assert {"kv-operation", "DEL"} in headers
      assert {:ok, %{status: "404"}} = get.("none")
    end

    test "are listed and deleted", %{gnat: gnat, bucket: bucket} do
      {:ok, _} = API.Stream.create(gnat, %API.Stream{name: unique("plain"), subjects: [unique("plain")]})
      assert {:ok, buckets} = KV.list_buckets(gnat)
      assert bucket in buckets
      refute Enum.any?(buckets, &String.starts_with?(&1, "plain"))
      assert KV.kv_bucket_stream?("KV_a") and not KV.kv_bucket_stream?("a")
      # Its former name, which the compiler warns of.
      assert apply(KV, :is_kv_bucket_stream?, ["KV_a"]) and not apply(KV, :is_kv_bucket_stream?, ["a"])
      assert :ok = KV.delete_bucket(gnat, bucket)
      assert {:error, %{"code" => 404}} = KV.info(gnat, bucket)
    end

    test "with an invalid name are refused", %{gnat: gnat} do
      for name <- ["a.b", "", "a b", "*", nil] do
        assert {:error, text} = KV.create_bucket(gnat, name)
        assert text =~ "bucket name"
        assert {:error, _} = KV.put_value(gnat, name, "a", "b")
        assert {:error, _} = KV.contents(gnat, name)
      end
    end
  end

  describe "values" do
    test "are put, got, deleted, purged", %{gnat: gnat, bucket: bucket} do
      assert {:error, %{"code" => 404}} = KV.get_value(gnat, bucket, "a.b")
      assert :ok = KV.put_value(gnat, bucket, "a.b", "1")
      assert :ok = KV.put_value(gnat, bucket, "a.b", ["2", ?2])
      assert "22" = KV.get_value(gnat, bucket, "a.b")
      assert :ok = KV.delete_key(gnat, bucket, "a.b")
      assert nil == KV.get_value(gnat, bucket, "a.b")
      assert {:ok, %{state: %{messages: 3}}} = KV.info(gnat, bucket)
      assert :ok = KV.purge_key(gnat, bucket, "a.b")
      assert nil == KV.get_value(gnat, bucket, "a.b")
      assert {:ok, %{state: %{messages: 1}}} = KV.info(gnat, bucket)
    end

    test "may be any bytes, or empty", %{gnat: gnat, bucket: bucket} do
      for value <- ["", <<0, 255>>, "ü", :binary.copy("x", 100_000)] do
        assert :ok = KV.put_value(gnat, bucket, "v", value)
        assert KV.get_value(gnat, bucket, "v") == value
      end
    end

    test "of invalid keys are refused", %{gnat: gnat, bucket: bucket} do
      for key <- [
            "",
            ".",
            "a.",
            ".a",
            "a..b",
            "a b",
            "*",
            "a.>",
            "a\r\nb",
            "ü",
            nil,
            String.duplicate("x", 513)
          ] do
        assert {:error, %Error{reason: {:invalid_subject, ^key}}} = KV.put_value(gnat, bucket, key, "1")
        assert {:error, %Error{}} = KV.get_value(gnat, bucket, key)
        assert {:error, %Error{}} = KV.delete_key(gnat, bucket, key)
      end
    end

    test "in a missing bucket are errors", %{gnat: gnat} do
      assert {:error, :no_responders} = KV.put_value(gnat, "nowhere", "a", "b")
      assert {:error, %{"code" => 404}} = KV.get_value(gnat, "nowhere", "a")
      assert {:error, %{"code" => 404}} = KV.contents(gnat, "nowhere")
    end

    test "all at once", %{gnat: gnat, bucket: bucket} do
      assert {:ok, %{}} = KV.contents(gnat, bucket)
      assert {:ok, []} = KV.keys(gnat, bucket)
      for n <- 1..30, do: :ok = KV.put_value(gnat, bucket, "k.#{n}", "old")
      for n <- 1..30, do: :ok = KV.put_value(gnat, bucket, "k.#{n}", "#{n}")
      :ok = KV.delete_key(gnat, bucket, "k.7")
      :ok = KV.purge_key(gnat, bucket, "k.8")
      expected = for n <- 1..30, n not in [7, 8], into: %{}, do: {"k.#{n}", "#{n}"}
      assert {:ok, ^expected} = KV.contents(gnat, bucket)
      assert {:ok, ^expected} = KV.contents(gnat, bucket, batch: 4)
      keys = expected |> Map.keys() |> Enum.sort()
      assert {:ok, ^keys} = KV.keys(gnat, bucket)
      # The consumers that read are gone.
      assert {:ok, %{consumers: []}} = Consumer.list(gnat, "KV_" <> bucket)
    end
  end

  describe "creating a key" do
    test "writes only a key without a value", %{gnat: gnat, bucket: bucket} do
      assert :ok = KV.create_key(gnat, bucket, "k", "1")
      assert {:error, :wrong_revision} = KV.create_key(gnat, bucket, "k", "2")
      assert :ok = KV.delete_key(gnat, bucket, "k")
      assert :ok = KV.create_key(gnat, bucket, "k", "3")
      assert "3" = KV.get_value(gnat, bucket, "k")
    end
  end

  describe "watch" do
    test "reports present values and every change", %{gnat: gnat, bucket: bucket} do
      :ok = KV.put_value(gnat, bucket, "a", "1")
      :ok = KV.put_value(gnat, bucket, "a", "2")
      {:ok, watcher} = KV.watch(gnat, bucket, tell(self()))
      assert_receive {:key_added, "a", "2"}
      :ok = KV.put_value(gnat, bucket, "b.c", "3")
      :ok = KV.delete_key(gnat, bucket, "a")
      :ok = KV.purge_key(gnat, bucket, "b.c")
      assert_receive {:key_added, "b.c", "3"}
      assert_receive {:key_deleted, "a", ""}
      assert_receive {:key_purged, "b.c", ""}

      assert :ok = KV.unwatch(watcher)
      :ok = KV.put_value(gnat, bucket, "a", "4")
      :ok = Gnat.flush(gnat)
      refute_received {_action, _key, _value}
      assert {:ok, %{consumers: []}} = Consumer.list(gnat, "KV_" <> bucket)
    end

    test "keeps up with many changes, in order", %{gnat: gnat, bucket: bucket} do
      {:ok, _} = KV.watch(gnat, bucket, tell(self()))
      for n <- 1..1_000, do: :ok = Gnat.pub(gnat, "$KV.#{bucket}.k#{rem(n, 400)}", "#{n}")
      got = for _ <- 1..1_000, do: receive(do: ({:key_added, _key, value} -> String.to_integer(value)))
      assert got == Enum.to_list(1..1_000)
    end

    test "of a missing bucket is an error, not an exit", %{gnat: gnat} do
      assert {:error, %{"code" => 404}} = KV.watch(gnat, "nowhere", tell(self()))

      assert {:error, %Error{reason: :not_connected}} =
               KV.watch(:nobody_has_this_name, "nowhere", tell(self()))
    end

    test "goes on when its consumer is deleted", %{gnat: gnat, bucket: bucket} do
      {:ok, watcher} =
        KV.Watcher.start_link(conn: gnat, bucket_name: bucket, handler: tell(self()), idle_heartbeat: 100)

      :ok = KV.put_value(gnat, bucket, "a", "1")
      assert_receive {:key_added, "a", "1"}

      # On a busy machine a silence of a quarter of a second is taken for its end, too, and it is just getting another one.
      eventually(fn ->
        with {:ok, %{consumers: [consumer]}} <- Consumer.list(gnat, "KV_" <> bucket),
             :ok <- Consumer.delete(gnat, "KV_" <> bucket, consumer),
             do: true,
             else: (_none -> nil)
      end)

      :ok = KV.put_value(gnat, bucket, "a", "2")
      assert_receive {:key_added, "a", "2"}
      refute_received {:key_added, "a", "1"}
      KV.unwatch(watcher)
    end

    test "starts over with a bucket that was created again", %{gnat: gnat, bucket: bucket} do
      {:ok, watcher} =
        KV.Watcher.start_link(conn: gnat, bucket_name: bucket, handler: tell(self()), idle_heartbeat: 100)

      for n <- 1..5, do: :ok = KV.put_value(gnat, bucket, "a", "#{n}")
      assert_receive {:key_added, "a", "5"}
      :ok = KV.delete_bucket(gnat, bucket)
      {:ok, _} = KV.create_bucket(gnat, bucket)
      :ok = KV.put_value(gnat, bucket, "b", "new")
      assert_receive {:key_added, "b", "new"}
      KV.unwatch(watcher)
    end

    test "goes on after kill -9 of the server, without a gap and without a repetition" do
      server = start_supervised!({NatsServer, jetstream: true}, id: :killed)
      name = supervised_connection(server)
      {:ok, _} = KV.create_bucket(name, "b", history: 10)
      {:ok, watcher} = KV.watch(name, "b", tell(self()))
      :ok = KV.put_value(name, "b", "a", "1")
      assert_receive {:key_added, "a", "1"}

      :ok = NatsServer.kill(server)
      :ok = NatsServer.start(server)
      assert_receive {:telemetry, [:gnat, :connection, :up], _, %{name: ^name}}
      for n <- 2..4, do: :ok = KV.put_value(name, "b", "a", "#{n}")
      assert ["2", "3", "4"] = for(_ <- 2..4, do: receive(do: ({:key_added, "a", value} -> value)))
      refute_received {:key_added, _, _}
      KV.unwatch(watcher)
    end

    test "of a connection by its pid ends with it", %{server: server, bucket: bucket} do
      {:ok, gnat} = Gnat.start_link(NatsServer.settings(server))
      Process.flag(:trap_exit, true)
      {:ok, watcher} = KV.watch(gnat, bucket, tell(self()))
      Gnat.stop(gnat)
      assert_receive {:EXIT, ^watcher, {:shutdown, :not_connected}}
    end
  end

  defp tell(test), do: fn action, key, value -> send(test, {action, key, value}) end
end
