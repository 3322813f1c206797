// Acknowledged unicast over distance. One 802.11 station sends datagrams to another one with a power that
// leaves no errors by noise; the only limit is the time for which the sender waits for the acknowledgement
// to begin at its receiver: SIFS + slot + preamble and header of the ACK, which 3.37 begins to count at the
// end of the data frame. --slot lengthens the slot as a coverage class does (3 us a class).
// Prints standard, mode, rts, slot_us, distance_m, run, datagrams, transmissions (of data frames, retries
// included), received (by the peer, duplicates excluded), acknowledged (datagrams), timed_out
// (transmissions of data frames, or with --rts of RTS).
#include "network.h"

using namespace reference;

int
main(int argc, char* argv[])
{
    double distanceM = 1340.0;
    double slotUs = 9.0;
    bool vht = false;
    std::string mode = "OfdmRate6Mbps";
    bool rts = false;
    uint32_t datagrams = 100;
    uint32_t payloadBytes = 1000;
    bool timeline = false;
    CommandLine command(__FILE__);
    command.AddValue("distance", "distance, m", distanceM);
    command.AddValue("slot", "slot time, us", slotUs);
    command.AddValue("vht", "802.11ac at 80 MHz instead of 802.11a", vht);
    command.AddValue("mode", "mode of data frames", mode);
    command.AddValue("rts", "send RTS before each frame", rts);
    command.AddValue("datagrams", "datagrams, one every 100 ms", datagrams);
    command.AddValue("payload", "UDP payload, B", payloadBytes);
    command.AddValue("timeline", "print transmissions", timeline);
    command.Parse(argc, argv);

    WifiSettings settings;
    settings.standard = vht ? WIFI_STANDARD_80211ac : WIFI_STANDARD_80211a;
    settings.qos = vht;
    settings.widthMhz = vht ? 80 : 20;
    settings.dataMode = mode;
    settings.slotUs = slotUs;
    settings.rtsThresholdBytes = rts ? 0 : settings.rtsThresholdBytes;
    NodeContainer nodes(2);
    auto positions = CreateObject<ListPositionAllocator>();
    positions->Add(Vector(0.0, 0.0, 10.0));
    positions->Add(Vector(distanceM, 0.0, 10.0));
    auto devices = InstallWifi(settings, nodes, EqualPower(-40.0), positions);
    if (timeline)
    {
        PrintTransmissions(devices);
    }

    uint64_t sent = 0;
    uint64_t acknowledged = 0;
    uint64_t timedOut = 0;
    auto mac = MacOf(devices.Get(0));
    auto phy = DynamicCast<WifiNetDevice>(devices.Get(0))->GetPhy();
    phy->TraceConnectWithoutContext(
        "PhyTxPsduBegin",
        Callback<void, WifiConstPsduMap, WifiTxVector, double>(
            [&](WifiConstPsduMap psdus, WifiTxVector, double) {
                sent += psdus.begin()->second->GetHeader(0).IsData();
            }));
    mac->TraceConnectWithoutContext(
        "AckedMpdu",
        Callback<void, Ptr<const WifiMpdu>>(
            [&](Ptr<const WifiMpdu> mpdu) { acknowledged += mpdu->GetHeader().IsData(); }));
    mac->TraceConnectWithoutContext(
        "MpduResponseTimeout",
        Callback<void, uint8_t, Ptr<const WifiMpdu>, const WifiTxVector&>(
            [&](uint8_t, Ptr<const WifiMpdu> mpdu, const WifiTxVector&) {
                timedOut += mpdu->GetHeader().IsData();
            }));
    Sink sink(devices.Get(1));
    for (uint32_t i = 0; i < datagrams; i++)
    {
        Simulator::Schedule(MilliSeconds(100 * (i + 1)), [&] {
            devices.Get(0)->Send(Create<Packet>(payloadBytes + UDP_IP_BYTES),
                                 devices.Get(1)->GetAddress(),
                                 IPV4_ETHER_TYPE);
        });
    }
    Simulator::Stop(MilliSeconds(100 * (datagrams + 2)));
    Simulator::Run();
    std::cout << (vht ? "80211ac" : "80211a") << "," << mode << "," << rts << "," << slotUs << ","
              << distanceM << "," << RngSeedManager::GetRun() << "," << datagrams << "," << sent << ","
              << sink.Packets(payloadBytes) << "," << acknowledged << "," << timedOut << std::endl;
    Simulator::Destroy();
}
